"""Where the images really look, and how high the ground is: altitude range, tie points, relative pointing."""
