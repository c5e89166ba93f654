"""A scene's files as artifacts: pieces, and the manifest that says where each file lies (`JobSpec.bundle`)."""

import pathlib
import struct

import zstandard
from blake3 import blake3

# From this size on a file is a piece of its own, and so many bytes of small ones are one.
LARGE = 256 << 10
PACK = 1 << 20


def gather(scene, others):
    """The scene's files by their paths within the bundle: the scene file and others, which lie in or below its folder."""
    folder = scene.resolve().parent
    files = {}
    for given in [scene, *others]:
        found = sorted(given.rglob("*")) if given.is_dir() else [given]
        for path in (path.resolve() for path in found if not path.is_dir()):
            if not path.is_relative_to(folder):
                raise ValueError(f"{path} does not lie below {folder}, the scene's folder")
            files[path.relative_to(folder).as_posix()] = path.read_bytes()
    return files


def groups(files):
    """Lists of paths that are packed together."""
    pack, size = [], 0
    for path, content in files.items():
        if len(content) >= LARGE:
            yield [path]
            continue
        if size + len(content) > PACK:
            yield pack
            pack, size = [], 0
        pack.append(path)
        size += len(content)
    if pack:
        yield pack


def pack(files):
    """The manifest's bytes, and the pieces'."""
    pieces, table, extents = [], b"", {}
    for number, paths in enumerate(groups(files)):
        content = b"".join(files[path] for path in paths)
        piece = zstandard.ZstdCompressor(level=3).compress(content)
        offset = 0
        for path in paths:
            extents[path.encode()] = struct.pack("<IQQ", number, offset, len(files[path]))
            offset += len(files[path])
        pieces.append(piece)
        table += blake3(piece).digest() + struct.pack("<QQ", len(piece), len(content))
    manifest = b"femcmnft" + struct.pack("<II", 1, len(pieces)) + table + struct.pack("<I", len(extents))
    for path in sorted(extents):
        manifest += struct.pack("<I", len(path)) + path + extents[path]
    return manifest, pieces
