"""Error budget of a volume, with causes of uncertainty that are measured on the scan itself."""
