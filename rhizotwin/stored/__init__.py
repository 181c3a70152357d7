"""Read, check and tabulate result folders, and detect changes of the code on which results depend."""
