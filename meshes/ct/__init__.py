"""Patient CT: content of an image, its labels and their names, and bone with its density."""
