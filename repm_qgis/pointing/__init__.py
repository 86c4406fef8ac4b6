"""Where the images really look: relative pointing from ties, ground control, waves of the attitude."""
