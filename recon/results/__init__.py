"""Results of a reconstruction, in memory and as folders: numbers, traits and files."""
