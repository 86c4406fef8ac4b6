"""What all rooms agree on: types, options, records, products, expected failures, and what values of them may be."""
