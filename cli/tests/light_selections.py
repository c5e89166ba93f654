"""Counts of selected records, computed from the tables of `femc paths` with polars.

usage: light_selections.py FOLDER    (with paths.parquet, intersections.parquet and lights.parquet of all records)

Prints JSON: for each condition the numbers of paths, intersections and lights. Each condition is written here a second time, as
operations on tables. No code of femc takes part.
"""

import json
import sys

import polars as pl

folder = sys.argv[1]
P = pl.read_parquet(f"{folder}/paths.parquet")
I = pl.read_parquet(f"{folder}/intersections.parquet")
L = pl.read_parquet(f"{folder}/lights.parquet")
# Lights with the intersection where they were sampled; null: at the camera.
at = I.select(pl.col("path"), pl.col("vertex"), pl.all().exclude("path", "vertex", "file", "frame").name.prefix("at_"))
L = L.with_row_index("light_row").join(at, on=["path", "vertex"], how="left")


def within(column, name):
    """Matches an object and everything in it."""
    text = pl.col(column).fill_null("")
    return (text == name) | text.str.starts_with(name + ".") | text.str.starts_with(name + "/")


def is_true(expression):
    return expression.fill_null(False)


def luminance(prefix=""):
    return 0.2126 * pl.col(prefix + "radiance_r") + 0.7152 * pl.col(prefix + "radiance_g") + 0.0722 * pl.col(prefix + "radiance_b")


def counts(paths, intersections, lights):
    chosen = set(paths)
    own = pl.col("path").is_in(list(chosen))
    return {
        "paths": len(chosen),
        "intersections": I.filter(own & is_true(intersections)).height,
        "lights": L.filter(own & is_true(lights)).height,
    }


ALL = pl.lit(True)


def of_paths(condition):
    return P.filter(is_true(condition))["path"]


def some(condition):
    """Returns the paths with some intersection of this kind."""
    return I.filter(is_true(condition))["path"]


def some_light(condition):
    return L.filter(is_true(condition))["path"]


def in_lasso(points):
    """Tests the centers of pixels with the even-odd rule."""
    def test(x, y):
        inside = False
        for (x0, y0), (x1, y1) in zip(points, points[1:] + points[:1]):
            if (y0 <= y) != (y1 <= y) and x0 + (y - y0) / (y1 - y0) * (x1 - x0) <= x:
                inside = not inside
        return inside
    return [path for path, x, y in P.select("path", "pixel_x", "pixel_y").iter_rows() if test(x + 0.5, y + 0.5)]


def visits(first, second):
    """Returns the paths that visit the first object and later the second."""
    a = I.filter(within("object", first)).group_by("path").agg(pl.col("vertex").min().alias("from"))
    return I.filter(within("object", second)).join(a, on="path").filter(pl.col("vertex") > pl.col("from"))["path"]


def in_box(prefix):
    x, y, z = (pl.col(prefix + axis) for axis in "xyz")
    return x.is_between(-1, 1) & y.is_between(-1, 1) & z.is_between(0, 1.5)


every = set(P["path"])
without = every - set(I["path"])
dim = pl.col("radiance_g") < 1
bright_at = I.join(L.filter(~dim).select("path", "vertex").unique().with_columns(pl.lit(True).alias("bright")), on=["path", "vertex"], how="left")
I = bright_at.with_columns(pl.col("bright").fill_null(False))


def has_light(name, condition):
    """Adds a column to the intersections: whether a light of this kind was sampled there."""
    global I
    own = L.filter(is_true(condition)).select("path", "vertex").unique().with_columns(pl.lit(True).alias(name))
    I = I.join(own, on=["path", "vertex"], how="left").with_columns(pl.col(name).fill_null(False))


has_light("shadow", within("occluder", "pedestals"))
has_light("surface", pl.col("found") == "surface")
has_light("statue", within("occluder", "statue"))
by_statue = set(some_light(within("occluder", "statue")))

result = {
    "depth >= 3 and depth <= 5": counts(of_paths(pl.col("depth").is_between(3, 5)), ALL, ALL),
    "any(interaction == reflection)": counts(
        some(pl.col("interaction") == "reflection"),
        pl.col("interaction") == "reflection",
        pl.col("at_interaction") == "reflection",
    ),
    "all(throughput.g > 0.05)": counts(
        every - without - set(some(pl.col("throughput_g") <= 0.05)), pl.col("throughput_g") > 0.05, pl.col("at_throughput_g") > 0.05
    ),
    "any(in box(-1,-1,0,1,1,1.5)) and depth < 6": counts(
        set(some(in_box(""))) & set(of_paths(pl.col("depth") < 6)), in_box(""), in_box("at_")
    ),
    "light(occluder == pedestals)": counts(
        some_light(within("occluder", "pedestals")), pl.col("shadow"), within("occluder", "pedestals")
    ),
    "lights(light.radiance.g < 1)": counts(every - set(some_light(~dim)), ~pl.col("bright"), dim),
    "sphere then room": counts(visits("sphere", "room"), ALL, ALL),
    "in box(-1,-1,0,1,1,1.5)": counts(some(in_box("")), in_box(""), ALL),
    "in lasso(10,10,50,10,30,40)": counts(in_lasso([(10, 10), (50, 10), (30, 40)]), ALL, ALL),
    "not object == room": counts(
        set(some(~within("object", "room"))) | without, ~within("object", "room"), ALL
    ),
    "first.object == sphere and path.radiance.g > 5": counts(
        set(I.filter((pl.col("vertex") == 1) & within("object", "sphere"))["path"]) & set(of_paths(pl.col("radiance_g") > 5)), ALL, ALL
    ),
    "pixel.x == 32 and pixel.y < 24 or brightest.radiance > 20": counts(
        set(of_paths((pl.col("pixel_x") == 32) & (pl.col("pixel_y") < 24))) | set(some_light(luminance() > 20)), ALL, ALL
    ),
    "bounce == 1 and found == surface and not light(occluder == statue)": counts(
        set(some((pl.col("bounce") == 1) & pl.col("surface"))) - by_statue,
        (pl.col("bounce") == 1) & pl.col("surface") & ~pl.col("statue"),
        (pl.col("at_bounce") == 1) & (pl.col("found") == "surface") & ~within("occluder", "statue"),
    ),
    "material == chrome and position.z > 0.5 and throughput.r < 0.9": counts(
        some(within("material", "chrome") & (pl.col("z") > 0.5) & (pl.col("throughput_r") < 0.9)),
        within("material", "chrome") & (pl.col("z") > 0.5) & (pl.col("throughput_r") < 0.9),
        ALL,
    ),
}
print(json.dumps(result))
