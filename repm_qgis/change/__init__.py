"""What changed between two dates: differences of two DSMs, which of them are significant, and their volumes."""
