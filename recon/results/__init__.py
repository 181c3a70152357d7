"""Results as objects in memory and as folders: numbers, traits and files."""
