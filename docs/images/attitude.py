"""Draw docs/images/attitude.png: python docs/images/attitude.py (from the top folder)."""

from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.patches import Arc, Polygon

BODY, WORLD, SIGHT = "C0", "0.4", "C3"


def turned(points, degrees):
    """Return points turned counterclockwise on the page."""
    angle = np.radians(degrees)
    return points @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def arrow(ax, degrees, length, text, colour, *, start=(0.0, 0.0), away=0.13, style="-"):
    """Draw an arrow at an angle counterclockwise from the page's right, with a label."""
    angle = np.radians(degrees)
    way = np.array([np.cos(angle), np.sin(angle)])
    tip = np.add(start, length * way)
    props = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.6, "linestyle": style}
    ax.annotate("", tip, start, arrowprops=props)
    ax.text(*(tip + away * way), text, color=colour, ha="center", va="center", fontsize=10)


def arc(ax, angles, radius, text, colour):
    """Draw an arc between two angles, with a label in its middle."""
    low, high = angles
    ax.add_patch(Arc((0, 0), 2 * radius, 2 * radius, theta1=low, theta2=high, color=colour))
    middle = np.radians(0.5 * (low + high))
    place = (radius + 0.16) * np.array([np.cos(middle), np.sin(middle)])
    ax.text(*place, text, color=colour, ha="center", va="center", fontsize=10)


def shape(ax, points, degrees):
    """Draw an outline, turned."""
    ax.add_patch(Polygon(turned(np.array(points), degrees), color=BODY, alpha=0.15, linewidth=0))


TOP = [
    (0.55, 0), (0.35, 0.07), (0.12, 0.08), (0, 0.6), (-0.12, 0.6), (-0.1, 0.07), (-0.4, 0.04),
    (-0.45, 0.2), (-0.52, 0.2), (-0.52, -0.2), (-0.45, -0.2), (-0.4, -0.04), (-0.1, -0.07),
    (-0.12, -0.6), (0, -0.6), (0.12, -0.08), (0.35, -0.07),
]  # fmt: skip
SIDE = [(0.55, -0.02), (0.3, 0.08), (-0.35, 0.06), (-0.5, 0.24), (-0.58, 0.24), (-0.5, 0.0),
        (0.2, -0.08)]  # fmt: skip
REAR = [(-0.7, 0.02), (-0.1, 0.05), (-0.03, 0.25), (0.03, 0.25), (0.1, 0.05), (0.7, 0.02),
        (0.1, -0.06), (-0.1, -0.06)]  # fmt: skip

figure, (top, side, rear) = plt.subplots(1, 3, figsize=(12.5, 4.4), layout="constrained")
for ax, title in (
    (top, "from above: yaw, azimuth"),
    (side, "from the right: pitch, elevation"),
    (rear, "from behind: roll"),
):
    ax.set_title(title, fontsize=11)
    ax.set_xlim(-1.35, 1.5)
    ax.set_ylim(-1.3, 1.4)
    ax.set_aspect("equal")
    ax.axis("off")

# From above, clockwise is positive: yaw 35 degrees, azimuth 70.
shape(top, TOP, 90 - 35)
arrow(top, 90, 1.1, "north", WORLD)
arrow(top, 0, 1.1, "east", WORLD)
arrow(top, 55, 1.05, "x forward", BODY, away=0.16)
arrow(top, -35, 1.0, "y right", BODY)
arrow(top, 55 - 65, 1.2, "object", SIGHT, away=0.18, style="--")
arc(top, (55, 90), 0.75, "yaw", WORLD)
arc(top, (-10, 55), 0.5, "azimuth", SIGHT)

# From the right, the nose to the right: pitch 20 degrees up, elevation 60 degrees below.
shape(side, SIDE, 20)
arrow(side, 0, 1.2, "level", WORLD, away=0.16)
arrow(side, -90, 1.1, "down", WORLD)
arrow(side, 20, 1.05, "x forward", BODY, away=0.22)
arrow(side, -70, 1.05, "z down", BODY, away=0.16)
arrow(side, 110, 0.85, "elevation 90", BODY, away=0.12, style=":")
arrow(side, -40, 1.25, "object", SIGHT, away=0.17, style="--")
arc(side, (0, 20), 0.85, "pitch", WORLD)
arc(side, (-40, 20), 0.45, "", SIGHT)
side.text(0.82, -0.25, "elevation\n(negative)", color=SIGHT, ha="center", va="center", fontsize=10)

# From behind, the right wing to the right: roll 25 degrees, right wing down.
shape(rear, REAR, -25)
arrow(rear, 0, 1.2, "level", WORLD, away=0.16)
arrow(rear, -90, 1.1, "down", WORLD)
arrow(rear, -25, 1.05, "y right", BODY, away=0.17)
arrow(rear, -115, 1.05, "z down", BODY, away=0.15)
arc(rear, (-25, 0), 0.8, "roll", WORLD)

figure.savefig(Path(__file__).parent / "attitude.png", dpi=90)
