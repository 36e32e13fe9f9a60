"""Tables and model cards, rendered from the JSON of measurements."""
