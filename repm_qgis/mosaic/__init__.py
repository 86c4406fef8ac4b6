"""Many DSMs to one: their vertical offsets, the seams between them, and the blocks in which the mosaic is made."""
