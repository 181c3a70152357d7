"""Reports of results as self-contained HTML pages, and the figures of results."""
