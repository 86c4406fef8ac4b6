"""Is it right? Metrics, co-registration, charts, pictures, map styles and the HTML reports that show them."""
