"""Many scans: which are to be done, where they run, what became of each, and one page over all of them."""
