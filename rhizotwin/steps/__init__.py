"""Steps of a scan as functions, shared by the commands and the Python interface, with checks of their arguments."""
