"""Training: one loop for all models, and the data and losses of each."""
