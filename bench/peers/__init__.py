"""Stillroom's simulator beside others: the same kitchens, triangles, bodies and motions, one core."""
