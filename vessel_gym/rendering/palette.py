"""Colours of pictures: red, green and blue from 0 to 255."""

Colour = tuple[int, int, int]

PAPER: Colour = (241, 244, 247)
PANEL: Colour = (255, 255, 255)
WATER: Colour = (246, 250, 253)
EDGE: Colour = (221, 227, 234)
GRID: Colour = (234, 238, 243)
ZERO: Colour = (203, 211, 220)
TEXT: Colour = (31, 41, 55)
MUTED: Colour = (104, 116, 131)
TRUE: Colour = (29, 88, 158)
TRUE_PALE: Colour = (196, 214, 234)
TRUE_SOFT: Colour = (128, 171, 219)
BELIEVED: Colour = (226, 112, 22)
BELIEVED_PALE: Colour = (253, 228, 205)
COMMANDED: Colour = (138, 150, 164)
LIMIT: Colour = (196, 61, 61)
GOAL: Colour = (20, 140, 126)
MEMBER: Colour = (240, 165, 98)
FIX: Colour = (128, 78, 168)
OBSTACLE: Colour = (240, 216, 214)
LIGHT = {"true": TRUE, "true_soft": TRUE_SOFT, "believed": BELIEVED, "goal": GOAL, "measurement": FIX, "limit": LIMIT}
