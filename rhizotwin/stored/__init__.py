"""Result folders read back: checked, as values, as tables."""
