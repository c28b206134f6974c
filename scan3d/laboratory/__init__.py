"""What a laboratory does with measured data before they are reconstructed; this wing knows no true body and no simulation."""
