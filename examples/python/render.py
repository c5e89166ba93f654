#!/usr/bin/env python3
"""Renders a scene on a femc farm: submits it, watches it, fetches its frames and says how bright they are.

python3 render.py ../../scenes/cornell.mgf --size 64x64 --spp 16 -o out
"""

import argparse
import itertools
import json
import os
import pathlib
import sys
import uuid

import OpenEXR
from blake3 import blake3

import scene as scenes
from farm import Farm, Refused, Unreachable, identity, wire

DONE, FAILED, USAGE, AWAY = 0, 1, 2, 4


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=pathlib.Path, help="scene file")
    parser.add_argument("--with", dest="others", type=pathlib.Path, nargs="+", default=[], metavar="FILE",
                        help="files and folders that the scene names, below its folder")
    parser.add_argument("-o", "--out", type=pathlib.Path, default=pathlib.Path("out"), help="folder for the frames")
    parser.add_argument("--size", default="64x64", metavar="WxH", help="film, pixels")
    parser.add_argument("--frames", default="1", metavar="A..B", help="B included")
    parser.add_argument("--spp", type=int, default=16, metavar="N", help="samples a pixel")
    parser.add_argument("--seed", type=int, default=1, metavar="N")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="SELECTOR=VALUE")
    parser.add_argument("--server", default=os.environ.get("FEMC_SERVER", "http://127.0.0.1:7878"), metavar="URL")
    parser.add_argument("--identity", default=os.environ.get("FEMC_IDENTITY"), metavar="FILE",
                        help="who you are, for https://: one file of `femc ca issue`; or as three files of PEM:")
    parser.add_argument("--cert", metavar="FILE", help="your certificate")
    parser.add_argument("--key", metavar="FILE", help="its private key")
    parser.add_argument("--ca", metavar="FILE", help="the authority's certificate")
    return parser.parse_args()


def connect(args):
    three = [args.cert, args.key, args.ca]
    if any(three) and not all(three):
        raise ValueError("--cert, --key and --ca go together")
    if all(three):
        return Farm(args.server, *(pathlib.Path(path).read_bytes() for path in three))
    return Farm(args.server, *identity(args.identity)) if args.identity else Farm(args.server)


def graph(width, height, edge, spp):
    """The stages of a frame: tiles, groups of them where there are many, the image; `JobSpec.graph` says how."""
    tiles = [min(edge, width - x) * min(edge, height - y) for y in range(0, height, edge) for x in range(0, width, edge)]
    sizes = [wire.Sizes(tasks=len(list(run)), units=pixels) for pixels, run in itertools.groupby(tiles)]
    fan = min(256, 262144 // edge**2)

    def stage(kind, makes, tasks=1, **others):
        others = {"sizes": [wire.Sizes(tasks=tasks, units=1)], **others}
        return wire.Template(kind=kind, scope=wire.SCOPE_FRAME, makes=makes, **others)

    def read(number, role, **reach):
        return [wire.Need(stage=number, role=role, round=wire.ROUND_SAME, **reach)]

    stages = [stage(wire.STAGE_KIND_RENDER, [wire.ROLE_TILE], sizes=sizes, steps=[spp])]
    united = read(0, wire.ROLE_TILE, all=wire.Empty())
    if len(tiles) > fan:
        needs = read(0, wire.ROLE_TILE, fan=fan)
        stages.append(stage(wire.STAGE_KIND_REDUCE, [wire.ROLE_PIXELS], -(-len(tiles) // fan), needs=needs))
        united = read(1, wire.ROLE_PIXELS, all=wire.Empty())
    makes = [wire.ROLE_IMAGE, wire.ROLE_PREVIEW]
    stages.append(stage(wire.STAGE_KIND_IMAGE, makes, needs=united))
    return wire.Graph(stages=stages)


def job(args, bundle):
    """What is asked for. Film, tiles and stages follow from the settings: `JobSpec` says how."""
    width, height = (int(side) for side in args.size.split("x"))
    first, _, last = args.frames.partition("..")
    overrides = [(name, float(value)) for name, _, value in (text.partition("=") for text in args.overrides)]
    settings = {
        "camera": None,
        "size": [width, height],
        "stop": {"spp": args.spp},
        "method": "auto",
        "max_depth": 0,
        "filter": "box",
        "seed": args.seed,
        "overrides": overrides,
        "statistics": False,
    }

    def tiles(edge):
        return -(-width // edge) * -(-height // edge)

    edge = next((edge for edge in (128, 64, 32) if tiles(edge) >= 8), 16)
    return wire.JobSpec(
        name=args.scene.stem,
        bundle=bundle,
        entry=args.scene.name,
        settings=json.dumps(settings, separators=(",", ":")),
        frames=range(int(first), int(last or first) + 1),
        film_width=width,
        film_height=height,
        tile=edge,
        graph=graph(width, height, edge, args.spp),
        priority=50,
        owner=os.environ.get("USER", "nobody"),
    )


def follow(farm, number):
    """Says how far the job is until it has ended; its last status."""
    said = None
    for status in farm.watch(number):
        state = wire.JobState.Name(status.state).removeprefix("JOB_STATE_").lower()
        percent = 100 * status.samples_done // max(status.samples_planned, 1)
        line = f"job {number}: {state}, {status.frames_done} of {status.frames_total} frames, {percent} % of the samples"
        if line != said:
            print(line, file=sys.stderr)
        said = line
    return status


def trouble(status):
    """Why a job did not end well, as its workers told it."""
    failures = [("the job", status.failure)] if status.HasField("failure") else []
    failures += [(f"frame {lost.task.frame}", lost.failure) for lost in status.quarantined]
    for what, failure in failures:
        cause = failure.WhichOneof("cause")
        yield f"{what}: {cause}: {getattr(getattr(failure, cause), 'message', getattr(failure, cause))}"


def luminance(path):
    """Mean over the image, cd/m2: linear Rec.709."""
    with OpenEXR.File(str(path)) as file:
        rgb = file.channels()["RGB"].pixels
    return float((rgb @ [0.2126, 0.7152, 0.0722]).mean())


def run(args):
    farm = connect(args)
    manifest, pieces = scenes.pack(scenes.gather(args.scene, args.others))
    # The manifest last: it is there only if its pieces are.
    sent = farm.put([*pieces, manifest])
    number = farm.submit(job(args, blake3(manifest).digest()), str(uuid.uuid4()))
    print(f"job {number}: {args.scene}, {sent} bytes of it sent", file=sys.stderr)
    status = follow(farm, number)
    args.out.mkdir(parents=True, exist_ok=True)
    for frame in farm.frames(number):
        path = args.out / f"{status.name}.{frame.frame:04}.exr"
        image = next(output.artifact for output in frame.outputs if output.role == wire.ROLE_IMAGE)
        path.write_bytes(farm.get(image))
        print(f"{path}: mean luminance {luminance(path):.6g} cd/m2, {frame.spp} samples a pixel")
    if status.state != wire.JOB_STATE_DONE:
        print("\n".join([f"job {number} is not done", *trouble(status)]), file=sys.stderr)
        return FAILED
    return DONE


def main():
    args = arguments()
    try:
        return run(args)
    except Unreachable as error:
        print(f"{args.server} cannot be reached: {error}", file=sys.stderr)
        return AWAY
    except Refused as error:
        print(f"the coordinator refused ({error.reason or 'for no reason of its own'}): {error}", file=sys.stderr)
        return FAILED
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return USAGE


if __name__ == "__main__":
    sys.exit(main())
