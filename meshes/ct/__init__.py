"""Patient CT: inspection of an image, labels and their names, and bone with its density."""
