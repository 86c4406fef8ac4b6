"""Dense matching: pairs, epipolar rectification, matchers (one file a backend), and heights from disparities."""
