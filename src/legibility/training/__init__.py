"""How weights are made: one loop for every model, and what each is trained on."""
