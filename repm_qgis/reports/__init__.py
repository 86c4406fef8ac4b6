"""What people read of a run: reports with charts and pictures, verdicts, and the styles of layers on the map."""
