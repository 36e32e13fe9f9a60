"""Arms, their limits, and the files that their controllers read."""

ARM_NAMES = ("panda",)
"""The keys of `arm.ARMS`, without loading it."""
