"""More than two dates of one surface: trends with their errors, dates of change, and volumes over time."""
