"""Many scenes in one run: which they are, what became of each, and what shows all of them."""
