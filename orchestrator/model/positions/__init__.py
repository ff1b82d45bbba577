"""Named positions: those of the fleet file, those that are saved at run time, and the targets that name them."""
