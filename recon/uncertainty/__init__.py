"""How far a volume can be trusted: an error budget of causes measured on the scan itself."""
