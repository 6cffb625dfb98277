"""Colours of images by name: light for windows, light or dark by the reader's system for pages."""

LIGHT = {
    "page": "#f4f6f8", "paper": "#ffffff", "water": "#eaf1f7", "edge": "#d5dbe1", "grid": "#e3e8ed",
    "zero": "#c3cbd3", "ink": "#22303c", "muted": "#5a6570", "true": "#1f4e79",
    "true_soft": "#80abdb", "true_pale": "#c4d2e0", "believed": "#b04a00",
    "member": "#3f7f5f", "measurement": "#7b4f9d",
    "commanded": "#5a616b", "goal": "#3f7f5f", "obstacle": "#8c3b4a", "obstacle_pale": "#e2ced2",
    "second": "#b0187c",
}  # fmt: skip
DARK = LIGHT | {
    "page": "#10171e", "paper": "#17202a", "water": "#14222f", "edge": "#33404d", "grid": "#263340",
    "zero": "#33404d", "ink": "#e6ebf0", "muted": "#a6b1bc", "true": "#7db4ea",
    "true_soft": "#4a79a8", "believed": "#ff9a4d", "member": "#7fcfa4", "measurement": "#cba4ec",
    "commanded": "#a7b0ba", "goal": "#7fcfa4", "obstacle": "#e08a9a", "second": "#ff86c8",
}  # fmt: skip
