"""Colours of figures and environments, chosen for colour-blind readers too."""

INK, MUTED, OBSTACLE = "#222222", "#8a8a8a", "#b4b2c0"
GOALS = ("#c1121f", "#009e73", "#0072b2", "#e69f00", "#cc79a7", "#56b4e9", "#7f5539")
