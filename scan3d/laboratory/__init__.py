"""Tables from a rig become recordings.  Nothing here knows the true body or a simulation."""
