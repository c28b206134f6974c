"""Odd files and options, with what the commands should answer to them, and a fuzzer that looks for more."""
