"""Reports of results as self-contained HTML pages, and figures of results."""
