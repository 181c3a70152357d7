"""Read, check and tabulate result folders."""
