"""Networks, diffusion, the two stages and their checkpoints."""
