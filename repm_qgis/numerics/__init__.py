"""Statistics that all rooms share: what accuracy is called, and weights that gross errors do not move."""
