"""What the images can give, and what that costs: overlap, pairs, altitudes, promises of vendors, time and space."""
