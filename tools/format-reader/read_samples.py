"""Reads every sample of format-spec/samples and says which are not as the README has it.

Sound ones must be read to the last number and hold what expected.json says; of the damaged ones
each must be refused in the step of "How a reader validates" that names it. Ends with status 1 and
a line for each that is otherwise.
"""

import json
import math
import re
import sys
from pathlib import Path

from radiance import Pack
from reader import Holder, Kind, Refused, is_mirror, read, texels
from vlf import Vlf

# A word that must be in what the reader says of a damaged sample, beyond the step being right.
WORDS = {
    "text-mode.tiles": "text mode",
    "other-byte-order.tiles": "byte_order",
    "newer-major-version.tiles": "major_version",
    "flipped-bit-in-first-block.tiles": "first block: hash",
    "unknown-required-feature.tiles": "bits [7]",
    "reserved-byte-set.tiles": "FirstBlock.reserved",
    "truncated.tiles": "truncated by 1 ",
    "surplus.tiles": "1 surplus",
    "flipped-bit-in-directory.tiles": "directory: hash",
    "reserved-byte-in-entry-set.tiles": "DirectoryEntry.reserved",
    "another-kind.tiles": "of kind scene",
    "flipped-bit-in-chunk.tiles": "total_tiles of line 0: hash",
    "flipped-bit-in-frame.vlf": "scene of no line: hash",
    "swapped-chunks.vlf": "total_tiles of line",
    "moved-chunk.tiles": "total_tiles of line 1: hash",
}

# Samples in damaged/ that a reader reads all the same, and why. Those with an unknown bit that is
# required to write need no line here.
READABLE = {}

# Most that a looked up radiance may be off, relative to the brightest channel: roundings of f32.
TOLERANCE = 1e-5
# The same where it was rounded to f16 on the way: one step.
ROUNDED = 2**-10

HERE = Path(__file__).resolve().parent
failures = []


def check(holds, why):
    if not holds:
        failures.append(why)
        print(f"FAILED   {why}")


def wanted(name):
    """The kind of file that a name promises."""
    if name.endswith(".vlf"):
        return Holder.pack
    return Holder.__members__.get(Path(name).suffix.lstrip(".") or Path(name).name)


def attempt(path, **field):
    """A file, or why there is none."""
    try:
        return read(path.read_bytes(), wanted(path.name), **field), None
    except Refused as e:
        return None, e
    except Exception as e:  # A reader that breaks is a failure of that sample, not of the others.
        return None, Refused(0, f"the reader broke, {type(e).__name__}: {e}")


def sound_samples(folder, expected):
    """Reads them all; the packs and the record and scene of the others come first."""
    packs, field, totals = {}, {}, None
    paths = sorted(p for p in folder.iterdir() if p.is_file() and p.suffix != ".json")
    first = ["manifest", "scene"]
    for path in sorted(paths, key=lambda p: p.name not in first):
        name = path.name
        is_pack = wanted(name) == Holder.pack
        file, refused = attempt(path, **({} if is_pack else field))
        check(refused is None, f"{name}: refused in step {refused and refused.step}, {refused}")
        if refused:
            continue
        print(f"read     {name}: {file.block.file_kind.name}, chunks: {len(file.chunks)}")
        check_identity(name, file, expected)
        if is_pack:
            packs[name] = file
            check_pack(name, file, expected)
        elif name in first:
            kind = Kind.record if name == "manifest" else Kind.scene
            field[kind.name] = file.content(kind)
        elif file.content(Kind.total_tiles):
            totals = file
    check(len(packs) > 1 and len(field) == 2 and totals, "samples are missing")
    if failures:
        return
    parts = [[c.raw for c in file.chunks[:3]] for file in packs.values()]
    check(all(p == parts[0] for p in parts), f"{', '.join(packs)}: record, scene or textures differ")
    whole = next(c.raw for c in packs["raw.vlf"].chunks if c.entry.direction == 0)
    check(totals.chunks[0].raw == whole, "the total map of line 0 is not that of raw.vlf")
    check_manifest(field["record"])


def images_sample(path):
    """The scene of another field: a floor with an image of two by two pixels."""
    file, refused = attempt(path)
    check(refused is None, f"images/{path.name}: refused, {refused}")
    if refused:
        return
    print(f"read     images/{path.name}: {file.block.file_kind.name}, with an image")
    images = file.content(Kind.scene).images
    sizes = [(image.width, image.height, len(image.pixels)) for image in images.images]
    check(sizes == [(2, 2, 12)], f"images/{path.name}: images of {sizes}")
    check(images.images[0].pixels[:3] == bytes([255, 0, 0]), "the image does not begin with red")
    check([t.material for t in images.textures] == [0], "the texture is not the floor's")
    check([p.surface for p in images.placements] == [0], "the image is not on the floor")


def check_identity(name, file, expected):
    block = file.block
    says = {"field": block.field.hex(), "exponent": block.exponent, "surfaces": block.num_surfaces}
    for key, value in says.items():
        check(value == expected[key], f"{name}: {key} is {value}, not {expected[key]}")
    if record := file.content(Kind.record):
        parameters = {
            "directions": record.num_directions,
            "cycles": record.cycles if record.has_cycles else None,
            "supersample": record.supersample == 1,
            "one_sided": record.one_sided == 1,
            "transfer": record.transfer.name.capitalize(),
            "specular": record.specular.name.capitalize(),
            "resample": record.resample == 1,
        }
        same = "resolution tile unshot_fraction perturbations thinned texel_cells refined filter target_error".split()
        parameters |= {key: getattr(record, key) for key in same}
        for key in parameters.keys() | expected["parameters"].keys():
            here, there = parameters.get(key), expected["parameters"].get(key)
            check(here == there, f"{name}: parameter {key} is {here}, not {there}")
        digest = record.digest.hex()
        if record.phase == Vlf.Phase.finished:
            why = f"{name}: digest {digest}, not {expected['digest']}"
            check(digest == expected["digest"], why)


def check_manifest(record):
    """What the README's table of samples says of it."""
    lines = [i for i in range(record.num_directions) if record.done[i // 8] >> i % 8 & 1]
    at = (record.phase.name, record.cycle, lines, record.has_sums)
    check(at == ("propagating", 1, [0], 1), f"manifest: it stands at {at}")


def check_pack(name, file, expected):
    pack = Pack(file)
    check(len(expected["radiance"]) > 0, "expected.json has no radiance")
    other = expected["others"].get(name)
    for i, place in enumerate(expected["radiance"]):
        rgb = pack.radiance(place["surface"], place["point"], place["away"])
        wanted = other[i] if other else place["radiance"]
        most = (ROUNDED if other else TOLERANCE) * max(wanted)
        near = all(abs(a - b) <= most for a, b in zip(rgb, wanted))
        check(near, f"{name}: radiance {i} is {rgb}, not {wanted}")

    # What reflects nothing leaves what it emits and nothing else: in every texel, and whatever of
    # the nearest three lines is behind the side or does not show the surface, in every direction.
    scene, values = file.content(Kind.scene), file.content(Kind.total_textures).values
    for t, surface in enumerate(texels(scene, pack.record)):
        plane = scene.surfaces[surface]
        material = scene.materials[plane.material]
        if is_mirror(scene, surface) or any(material.reflectance):
            continue
        sides = [values[2 * t + side].channels for side in (0, 1)]
        check(sides == [material.emitted, [0, 0, 0]], f"{name}: texel {t} has {sides}")
        for turn in range(16):
            for height in (0.001, 0.1, 0.4, 1):
                rgb = pack.radiance(surface, plane.origin.xyz, away(plane, turn / 16, height))
                most = 2**-10 * max(material.emitted)
                near = all(abs(a - b) <= most for a, b in zip(rgb, material.emitted))
                check(near, f"{name}: surface {surface} shines {rgb}, turn {turn}, height {height}")


def away(plane, turn, height):
    """A direction that leaves the front at a height above the plane, 0 to 1."""
    flat, turn = math.sqrt(1 - height**2), math.tau * turn
    parts = (plane.u, flat * math.cos(turn)), (plane.v, flat * math.sin(turn)), (plane.normal, height)
    return [sum(axis.xyz[i] * part for axis, part in parts) for i in range(3)]


def steps_by_sample(text):
    """The step that the README names each damaged sample in."""
    section = re.search(r"^## How a reader validates$(.*?)^## ", text, re.M | re.S)[1]
    items = re.findall(r"^(\d+)\. (.*?)(?=^\d+\. |\Z)", section, re.M | re.S)
    return {
        name: int(number)
        for number, item in items
        for bracket in re.findall(r"\[(`[^\]]*`)\]", item)
        for name in re.findall(r"`([^`]+)`", bracket)
    }


def damaged_samples(folder, steps):
    paths = sorted(p for p in folder.iterdir() if p.is_file())
    for path in paths:
        name = path.name
        file, refused = attempt(path)
        if refused is None:
            bits = file.block.features.required_to_write
            why = READABLE.get(name) or bits and f"not to be changed, features {bits:#x}"
            check(why, f"{name}: read, though it is damaged")
            print(f"read     {name}: {why}")
            continue
        print(f"refused  {name}: step {refused.step}, {refused}")
        check(name not in READABLE, f"{name}: refused, though it can be read")
        check(name in steps, f"{name}: no step of the README names it")
        step, word = steps.get(name, refused.step), WORDS.get(name, "")
        check(refused.step == step, f"{name}: refused in step {refused.step}, not {step}")
        check(word in str(refused), f"{name}: `{word}` is not in: {refused}")
    missing = sorted((steps.keys() | WORDS.keys() | READABLE.keys()) - {p.name for p in paths})
    check(not missing, f"no such samples: {', '.join(missing)}")


def main():
    spec = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parents[1] / "format-spec"
    samples = spec / "samples"
    sound_samples(samples, json.loads((samples / "expected.json").read_text()))
    images_sample(samples / "images" / "scene")
    damaged_samples(samples / "damaged", steps_by_sample((spec / "README.md").read_text()))
    if failures:
        sys.exit(f"error: {len(failures)} of the samples' checks failed")
    print("All samples are as the README says")


if __name__ == "__main__":
    main()
