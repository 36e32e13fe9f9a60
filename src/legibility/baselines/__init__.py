"""What the modulator is compared with: other policies, and search without learning."""
