"""A result as a folder: numbers, traits, files, pictures and the page for people."""
