"""Import of existing pictures: their conversion to a dataset, with cameras from a file or without cameras."""
