"""How an observer reads a motion: the field, the scores and metrics, the labels."""
