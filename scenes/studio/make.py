#!/usr/bin/env python3
"""Writes studio.glb: a small studio kitchen as triangles, for scene.toml beside it.

Run it in this folder: python3 make.py. It needs nothing but Python. Axes are glTF's: metres, x right, y up, z towards
the beholder. Each solid is one primitive of its node's mesh, which is what Stillroom takes as one convex part.
"""

import json
import math
import struct

Point = tuple[float, float, float]
Solid = list[tuple[Point, Point, Point]]


def box(size: Point, at: Point = (0.0, 0.0, 0.0)) -> Solid:
    """A box of this size; `at` is the middle of its underside."""
    (x, y, z), (w, h, d) = at, size
    corner = [
        (x + sx * w / 2, y + sy * h, z + sz * d / 2)
        for sx, sy, sz in [(i % 2 * 2 - 1, i // 2 % 2, i // 4 * 2 - 1) for i in range(8)]
    ]
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return [t for a, b, c, d in faces for t in [(corner[a], corner[b], corner[c]), (corner[a], corner[c], corner[d])]]


def turned(rings: list[tuple[float, float]], at: Point = (0.0, 0.0, 0.0), sides: int = 24) -> Solid:
    """A profile of (radius, height), from below, turned about the upright axis through `at`."""

    def point(ring: tuple[float, float], side: int) -> Point:
        angle = 2 * math.pi * (side % sides) / sides
        return (at[0] + ring[0] * math.cos(angle), at[1] + ring[1], at[2] - ring[0] * math.sin(angle))

    triangles: Solid = []
    for low, high in zip(rings, rings[1:]):
        for i in range(sides):
            a, b, c, d = point(low, i), point(low, i + 1), point(high, i + 1), point(high, i)
            triangles += [(a, b, c), (a, c, d)]
    for ring, order in [(rings[0], -1), (rings[-1], 1)]:
        for i in range(1, sides - 1):
            triangles.append(tuple([point(ring, 0), point(ring, i), point(ring, i + 1)][::order]))
    return triangles


def cylinder(radius: float, height: float, at: Point = (0.0, 0.0, 0.0)) -> Solid:
    """An upright cylinder on `at`."""
    return turned([(radius, 0.0), (radius, height)], at)


def fruit(radius: float, height: float) -> list[Solid]:
    """A round thing on a low foot: a hull's own underside would rock."""
    rings = [(0.5, 0.0), (0.9, 0.25), (1.0, 0.55), (0.55, 1.0)]
    body = turned([(r * radius, 0.002 + h * (height - 0.002)) for r, h in rings], sides=12)
    return [cylinder(0.5 * radius, 0.004), body]


def legs(width: float, height: float, depth: float, thickness: float) -> list[Solid]:
    """Four legs at the corners of a rectangle."""
    x, z, leg = (width - thickness) / 2, (depth - thickness) / 2, (thickness, height, thickness)
    return [box(leg, (sx * x, 0.0, sz * z)) for sx in (-1, 1) for sz in (-1, 1)]


def room() -> list[tuple[str, Point, str, list[Solid]]]:
    """Every node: name, place, colour, solids about that place."""
    w, d, h, t = 3.6, 3.4, 2.5, 0.15
    shelf = [box((0.02, 1.3, 0.3), (x, 0.0, 0.0)) for x in (-0.41, 0.41)]
    shelf += [box((0.8, 0.03, 0.3), (0.0, y, 0.0)) for y in (0.42, 0.82, 1.27)]
    pot = [cylinder(0.1, 0.12)] + [box((0.04, 0.012, 0.06), (s * 0.118, 0.09, 0.0)) for s in (-1, 1)]
    mug = [cylinder(0.04, 0.095), box((0.028, 0.01, 0.012), (0.052, 0.07, 0.0)),
           box((0.028, 0.01, 0.012), (0.052, 0.018, 0.0)), box((0.01, 0.062, 0.012), (0.067, 0.018, 0.0))]
    kettle = [cylinder(0.085, 0.05), turned([(0.085, 0.05), (0.05, 0.16)]), box((0.05, 0.02, 0.024), (0.085, 0.1, 0.0)),
              box((0.012, 0.05, 0.016), (0.045, 0.155, 0.0)), box((0.012, 0.05, 0.016), (-0.045, 0.155, 0.0)),
              box((0.102, 0.014, 0.02), (0.0, 0.205, 0.0))]
    north, counter, table, board = -d / 2, 0.9, 0.74, 0.85
    return [
        ("Floor", (0, -0.1, 0), "oak", [box((w + 2 * t, 0.1, d + 2 * t))]),
        ("Wall-north", (0, 0, -(d + t) / 2), "plaster", [box((w + 2 * t, h, t))]),
        ("Wall-south", (0, 0, (d + t) / 2), "plaster", [box((w + 2 * t, h, t))]),
        ("Wall-west", (-(w + t) / 2, 0, 0), "plaster", [box((t, h, d))]),
        ("Wall-east", ((w + t) / 2, 0, 0), "plaster", [box((t, h, d))]),
        ("Window", (0.2, 1.15, north + 0.01), "glass", [box((1.2, 0.9, 0.02))]),
        ("Cabinets", (-0.3, 0, north + 0.28), "green", [box((3.0, counter - 0.04, 0.56))]),
        ("CounterTop", (-0.3, counter - 0.04, north + 0.31), "stone", [box((3.0, 0.04, 0.62))]),
        ("Fridge", (1.5, 0, north + 0.33), "steel",
         [box((0.58, 1.7, 0.66)), box((0.025, 0.7, 0.03), (-0.25, 0.7, 0.345))]),
        ("Shelves", (w / 2 - 0.45, 0, d / 2 - 0.16), "oak", shelf),
        ("Table", (-0.6, 0, 0.75), "oak", [box((1.1, 0.035, 0.7), (0, table - 0.035, 0))]
         + legs(1.02, table - 0.035, 0.62, 0.05)),
        ("Stool", (-0.6, 0, 1.33), "oak", [cylinder(0.17, 0.03, (0, 0.44, 0))] + legs(0.24, 0.44, 0.24, 0.03)),
        ("Bin", (1.5, 0, 0.2), "green", [cylinder(0.13, 0.02), turned([(0.13, 0.02), (0.15, 0.42)])]),
        ("Mug", (-0.3, table, 0.6), "blue", mug),
        ("Apple", (-0.85, table, 0.85), "red", fruit(0.037, 0.07)),
        ("Bread", (-1.4, counter, north + 0.3), "crust", [box((0.24, 0.1, 0.11))]),
        ("Pot", (-0.75, counter, north + 0.28), "iron", pot),
        ("Tomato", (0.25, counter, north + 0.4), "red", fruit(0.035, 0.055)),
        ("Plate", (-0.55, table, 0.9), "white", [cylinder(0.07, 0.006), turned([(0.07, 0.006), (0.115, 0.022)])]),
        ("Kettle", (0.85, counter, north + 0.28), "steel", kettle),
        ("Bottle", (0.45, counter, north + 0.2), "green", [cylinder(0.035, 0.19), cylinder(0.014, 0.08, (0, 0.19, 0))]),
        ("Book", (w / 2 - 0.55, board, d / 2 - 0.16), "blue", [box((0.2, 0.03, 0.14))]),
        ("Vase", (w / 2 - 0.3, board, d / 2 - 0.16), "glass",
         [cylinder(0.045, 0.01), turned([(0.045, 0.01), (0.06, 0.1), (0.03, 0.2)])]),
    ]


COLOURS = {
    "oak": (0.52, 0.34, 0.18), "plaster": (0.80, 0.77, 0.70), "glass": (0.38, 0.62, 0.80),
    "green": (0.16, 0.33, 0.27), "stone": (0.75, 0.74, 0.70), "steel": (0.55, 0.58, 0.62),
    "blue": (0.05, 0.16, 0.45), "red": (0.62, 0.04, 0.04), "crust": (0.55, 0.30, 0.08),
    "iron": (0.05, 0.05, 0.06), "white": (0.90, 0.90, 0.88),
}  # fmt: skip


def main() -> None:
    """Writes the file."""
    names = list(COLOURS)
    materials = [
        {"name": name, "pbrMetallicRoughness": {"baseColorFactor": [*COLOURS[name], 1.0], "metallicFactor": 0.0}}
        for name in names
    ]
    data = bytearray()
    accessors, views, meshes, nodes = [], [], [], []
    for name, at, colour, solids in room():
        primitives = []
        for solid in solids:
            points = [struct.pack("<3f", *corner) for triangle in solid for corner in triangle]
            distinct = sorted(set(points))
            index = {point: number for number, point in enumerate(distinct)}
            values = [struct.unpack("<3f", point) for point in distinct]
            for blob, target, count, more in [
                (b"".join(distinct), 34962, len(distinct),
                 {"componentType": 5126, "type": "VEC3",
                  "min": [min(v[i] for v in values) for i in range(3)],
                  "max": [max(v[i] for v in values) for i in range(3)]}),
                (b"".join(struct.pack("<H", index[point]) for point in points), 34963, len(points),
                 {"componentType": 5123, "type": "SCALAR"}),
            ]:  # fmt: skip
                views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(blob), "target": target})
                accessors.append({"bufferView": len(views) - 1, "count": count, **more})
                data += blob + bytes(-len(blob) % 4)
            primitives.append({"attributes": {"POSITION": len(accessors) - 2}, "indices": len(accessors) - 1,
                               "material": names.index(colour)})  # fmt: skip
        meshes.append({"name": name, "primitives": primitives})
        nodes.append({"name": name, "mesh": len(meshes) - 1, "translation": list(at)})
    document = {
        "asset": {"version": "2.0", "generator": "Stillroom scenes/studio/make.py"},
        "scene": 0,
        "scenes": [{"name": "Studio", "nodes": list(range(len(nodes)))}],
        "nodes": nodes, "meshes": meshes, "materials": materials,
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(data)}],
    }  # fmt: skip
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    with open("studio.glb", "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data)))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", len(data), b"BIN\0") + data)


if __name__ == "__main__":
    main()
