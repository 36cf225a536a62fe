"""Axes of machines: joints, rotary axes, and the motions that they give together."""
