"""Reads one file to its last number, checking in the README's order what `vlf.py` alone cannot.

Bytes in, a `File` out, or `Refused` with the step of "How a reader validates" that failed. Written
from format-spec/README.md; it shares nothing with the library. It takes polygons as simple and
apart from each other: whether they are is not a question of one number.
"""

import math
import struct
from dataclasses import dataclass

import xxhash
import zstandard
from kaitaistruct import BytesIO, KaitaiStream, KaitaiStruct, ValidationFailedError

from planes import from_planes
from vlf import Vlf

NONE = 0xFFFFFFFF
MAGIC = b"\x89VLF\r\n\x1a\n"

# The step in which what a type of `vlf.py` says is validated; the first that fits counts.
STEPS = [
    ("/types/preamble/seq/0", 1),
    ("/types/preamble/", 2),
    ("/types/features/", 2),
    ("/types/first_block/", 3),
    ("/types/directory_entry/instances/padding", 6),
    ("/types/directory_entry/", 5),
    ("", 7),
]

# The chunks of each kind of file. In a pack a total tile map of each line follows.
Kind, Holder = Vlf.ChunkKind, Vlf.FileKind
CHUNKS = {
    Holder.manifest: [[Kind.record]],
    Holder.scene: [[Kind.scene]],
    Holder.textures: [[Kind.total_textures, Kind.current_textures, Kind.half_textures]],
    Holder.sums: [[Kind.sums]],
    Holder.tiles: [[Kind.unshot_tiles, Kind.arrived_tiles], [Kind.total_tiles]],
    Holder.pack: [[Kind.record, Kind.scene, Kind.total_textures]],
}
CONTENT = {
    Kind.record: Vlf.Record,
    Kind.scene: Vlf.Scene,
    Kind.total_textures: Vlf.TextureMap,
    Kind.current_textures: Vlf.TextureMap,
    Kind.half_textures: Vlf.TextureMap,
    Kind.sums: Vlf.Sums,
    Kind.unshot_tiles: Vlf.TileMap,
    Kind.arrived_tiles: Vlf.TileMap,
    Kind.total_tiles: Vlf.TileMap,
}
ZERO_IN_PACKS = (
    "seconds bytes_written hits misses evictions redundant bytes peak wait sequence has_sync has_sums"
)

# How far the vectors and corners of a scene may be off: some roundings of f32 in the unit ball.
ROUNDING = 1e-5


class Refused(Exception):
    """Why a file is not read, and the step that found it."""

    def __init__(self, step, why):
        super().__init__(why)
        self.step = step


def require(holds, step, why):
    if not holds:
        raise Refused(step, why)


@dataclass
class Chunk:
    entry: Vlf.DirectoryEntry
    raw: bytes
    content: KaitaiStruct


@dataclass
class File:
    block: Vlf.FirstBlock
    chunks: list

    def content(self, kind):
        return next((c.content for c in self.chunks if c.entry.kind == kind), None)

    def raw(self, kind):
        return next(c.raw for c in self.chunks if c.entry.kind == kind)


def read(data, wanted=None, record=None, scene=None):
    """Reads a file of the wanted kind. Record and scene are the field's, for a file without them."""
    root = asked(lambda: Vlf(KaitaiStream(BytesIO(data))), 4)
    check_first_block(root)
    check_directory(root, len(data), wanted)
    file = File(root.first_block, [])
    for i, entry in enumerate(root.directory):
        raw = decoded(root, entry, f"chunk {i}, {entry.kind.name} of {line_name(entry.direction)}")
        make = CONTENT[entry.kind]
        stream = KaitaiStream(BytesIO(raw))
        content = asked(lambda: entry.content or make(stream, entry, root), 7)
        file.chunks.append(Chunk(entry, raw, content))
    check_contents(file, record, scene)
    return file


def asked(what, early_end):
    """What `vlf.py` reads, its faults as refusals; `early_end` is the step of an end too early."""
    try:
        return what()
    except EOFError as e:
        raise Refused(early_end, f"truncated: {e}") from e
    except UnicodeDecodeError as e:
        raise Refused(7, f"a name is not UTF-8: {e}") from e
    except ValidationFailedError as e:
        step = next(step for path, step in STEPS if e.src_path.startswith(path))
        where, why = place(e), str(e).split(": ", 1)[1]
        if where == "Preamble.magic" and e.actual[1:4] == MAGIC[1:4]:
            why = "the file was mangled in text mode"
        elif where == "Features.required_to_read":
            why = f"bits {[i for i in range(64) if e.actual >> i & 1]} are not known"
        raise Refused(step, f"{where}: {why}") from e


def place(error):
    """Type and field that a fault was found in: the one that was assigned last."""
    trace = error.__traceback__
    while trace.tb_next:
        trace = trace.tb_next
    part = trace.tb_frame.f_locals["self"]
    return f"{type(part).__name__}.{list(vars(part))[-1].removeprefix('_m_')}"


def line_name(direction):
    return "no line" if direction == NONE else f"line {direction}"


def check_first_block(root):
    # The hash comes before any number behind the versions is looked at.
    hashed = asked(lambda: xxhash.xxh3_64_intdigest(root.hashed), 4)
    stored = asked(lambda: root.first_block_hash, 4)
    require(stored == hashed, 2, f"first block: hash {hashed:016x}, not {stored:016x}")
    block = asked(lambda: root.first_block, 4)
    kind = block.file_kind
    has_line = block.direction != NONE
    require(has_line == (kind == Holder.tiles), 3, f"{kind.name} of {line_name(block.direction)}")
    if kind in (Holder.manifest, Holder.scene, Holder.pack):
        require(block.generation == 0, 3, f"{kind.name} of generation {block.generation}")


def check_directory(root, length, wanted):
    block = root.first_block
    short, over = block.len_file - length, length - block.len_file
    require(short <= 0, 4, f"file length: truncated by {short} bytes")
    require(over <= 0, 4, f"file length: {over} surplus bytes")
    end = 256 + 64 * block.num_chunks
    require(end <= length, 5, f"directory: {block.num_chunks} entries do not fit into the file")
    hashed = xxhash.xxh3_64_intdigest(root.directory_bytes)
    why = f"directory: hash {hashed:016x}, not {block.directory_hash:016x}"
    require(block.directory_hash == hashed, 5, why)

    asked(lambda: root.directory, 5)
    for i, entry in enumerate(root.directory):
        begins = rounded_up(end, 64)
        why = f"chunk {i} begins at {entry.ofs_stored}, not at {begins}: a hole or an overlap"
        require(entry.ofs_stored == begins, 5, why)
        end = begins + entry.len_stored
        require(end <= length, 5, f"chunk {i} ends at {end}, the file at {length}")
    why = f"the file ends at {length}, its last chunk at {end}"
    require(rounded_up(end, 64) == length, 5, why)
    why = f"a file of kind {block.file_kind.name}, not {wanted.name if wanted else 'wanted'}"
    require(wanted in (None, block.file_kind), 5, why)
    check_chunks(block, root.directory)
    # Belongs to the chunk that it stands behind, and is looked at with it.
    for entry in root.directory:
        asked(lambda: entry.padding, 6)


def rounded_up(number, step):
    return -(-number // step) * step


def check_chunks(block, entries):
    """That a file holds the chunks of its kind, and that they say they belong to it."""
    kinds, lines = [e.kind for e in entries], [e.direction for e in entries]
    allowed = CHUNKS[block.file_kind]
    if block.file_kind == Holder.pack:
        allowed = [allowed[0] + [Kind.total_tiles] * block.num_directions]
        expected = [NONE] * 3 + order_of_maps(block.num_directions)
    else:
        expected = [block.direction] * len(lines)
        cycles = {e.cycle for e in entries}
        why = f"chunks of cycles {cycles} in a file of generation {block.generation}"
        require(cycles <= {block.generation}, 5, why)
    names = [kind.name for kind in kinds]
    require(kinds in allowed, 5, f"chunks {names} in a file of kind {block.file_kind.name}")
    require(lines == expected, 5, f"chunks of lines {lines}")


def order_of_maps(lines):
    """The lines in the order in which a pack has their maps."""
    q = math.isqrt((lines - 1) // 2)
    keys = []
    for y in range(-q, q + 1):
        for x in range(abs(y) - q, q - abs(y) + 1):
            # Of the ends of a line on the equator the first one names it.
            if abs(x) + abs(y) < q or (y, x) < (0, 0):
                halved = next(h for h in range(q.bit_length(), -1, -1) if (x | y | q) % 2**h == 0)
                place = sum(
                    (x + q >> i & 1) << 2 * i | (y + q >> i & 1) << 2 * i + 1 for i in range(16)
                )
                keys.append((-halved, place, len(keys)))
    return [line for _, _, line in sorted(keys)]


def decoded(root, entry, name):
    """A chunk's raw bytes."""
    place = root.first_block.field + struct.pack("<III", entry.kind, entry.cycle, entry.direction)
    hashed = xxhash.xxh3_64_intdigest(entry.stored, xxhash.xxh3_64_intdigest(place))
    why = f"{name}: hash {hashed:016x}, not {entry.chunk_hash:016x}"
    require(entry.chunk_hash == hashed, 6, why)
    if entry.codec == Vlf.Codec.raw:
        return entry.stored
    is_frame = entry.stored[:4] == b"\x28\xb5\x2f\xfd"
    require(is_frame, 6, f"{name}: frame: not one of zstd")
    try:
        header = zstandard.get_frame_parameters(entry.stored)
        is_planes = entry.codec == Vlf.Codec.planes
        fits = header.content_size == entry.len_raw or is_planes and header.content_size < entry.len_raw
        require(fits, 6, f"{name}: frame: {header.content_size} bytes, not {entry.len_raw}")
        require(header.dict_id == 0, 6, f"{name}: frame: wants a dictionary")
        frame = zstandard.ZstdDecompressor().decompressobj()
        raw = frame.decompress(entry.stored)
    except zstandard.ZstdError as e:
        raise Refused(6, f"{name}: frame: {e}") from e
    require(frame.eof, 6, f"{name}: frame: ends too early")
    require(not frame.unused_data, 6, f"{name}: frame: {len(frame.unused_data)} bytes behind it")
    require(len(raw) == header.content_size, 6, f"{name}: frame: {len(raw)} bytes")
    if is_planes:
        try:
            raw = from_planes(raw)
        except (ValueError, struct.error, StopIteration, RuntimeError) as e:
            raise Refused(6, f"{name}: planes: {e}") from e
    require(len(raw) == entry.len_raw, 6, f"{name}: length {len(raw)}, not {entry.len_raw}")
    return raw


def xxh3_128(data):
    """As it is stored: a little-endian number."""
    return xxhash.xxh3_128_digest(data)[::-1]


def check_contents(file, record, scene):
    """Step 7, as far as it ties numbers to each other that `vlf.py` checks one by one."""
    if own := file.content(Kind.record):
        record = own
        check_record(file, own)
    if own := file.content(Kind.scene):
        scene = own
        check_scene(own)
        if record:
            why = "the scene is not the one whose hash the record has"
            require(xxh3_128(file.raw(Kind.scene)) == record.scene_hash, 7, why)
    values = 2 * len(texels(scene, record)) if scene and record else None
    for chunk in file.chunks:
        name = f"{chunk.entry.kind.name} of {line_name(chunk.entry.direction)}"
        if isinstance(chunk.content, (Vlf.TextureMap, Vlf.Sums)):
            # Sums are of two halves of the lines.
            halves = 2 if isinstance(chunk.content, Vlf.Sums) else 1
            expected = values and halves * values
            count = len(chunk.content.values)
            require(expected in (None, count), 7, f"{name}: {count} values, not {expected}")
        elif isinstance(chunk.content, Vlf.TileMap):
            check_tile_map(chunk.content, name)
            in_pack = file.block.file_kind == Holder.pack
            check_textured(chunk.content, name, in_pack, scene)
            if in_pack and scene and file.block.features.optional & 1:
                mirrors = all(is_mirror(scene, s) for s in chunk.content.surface)
                require(mirrors, 7, f"{name}: a diffuse surface that was left out")
            if scene and chunk.entry.kind != Kind.total_tiles:
                mirrors = all(is_mirror(scene, s) for s in chunk.content.surface)
                require(mirrors, 7, f"{name}: an entry of a diffuse surface")


def check_record(file, record):
    identity = xxh3_128(record.identity_bytes)
    why = f"record: identity {identity.hex()}, the file's {file.block.field.hex()}"
    require(identity == file.block.field, 7, why)
    finished = record.phase == Vlf.Phase.finished
    require(finished or not any(record.digest), 7, "record: the digest of an unfinished field")
    ledgers = [ledger.cycle for ledger in record.ledgers]
    require(ledgers == list(range(record.cycle)), 7, f"record: ledgers of the cycles {ledgers}")
    if file.block.file_kind == Holder.pack:
        require(finished, 7, f"record: a pack in phase {record.phase.name}")
        for name in ZERO_IN_PACKS.split():
            require(getattr(record, name) == 0, 7, f"record: {name} in a pack")
        cycles = {chunk.entry.cycle for chunk in file.chunks}
        require(cycles == {record.cycle}, 7, f"chunks of cycles {cycles}, a record of {record.cycle}")


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def cross(a, b):
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


def minus(a, b):
    return [x - y for x, y in zip(a, b)]


def check_scene(scene):
    for i, surface in enumerate(scene.surfaces):
        normal, origin, u, v = (x.xyz for x in (surface.normal, surface.origin, surface.u, surface.v))
        for name, vector in (("normal", normal), ("u", u), ("v", v)):
            off = abs(math.sqrt(dot(vector, vector)) - 1)
            require(off < ROUNDING, 7, f"surface {i}: {name} is not a unit vector")
        off = math.dist(cross(u, v), normal)
        require(off < ROUNDING, 7, f"surface {i}: u x v is not the normal")
        for polygon in surface.polygons:
            flat = []
            for corner in polygon.corners:
                away = minus(corner.xyz, origin)
                flat.append((dot(away, u), dot(away, v)))
                inside = all(
                    -ROUNDING <= x <= extent + ROUNDING for x, extent in zip(flat[-1], surface.extent)
                )
                require(inside, 7, f"surface {i}: a corner outside the rectangle")
                require(abs(dot(away, normal)) < ROUNDING, 7, f"surface {i}: a corner off its plane")
                in_ball = math.sqrt(dot(corner.xyz, corner.xyz)) <= 1 + ROUNDING
                require(in_ball, 7, f"surface {i}: a corner outside the ball")
            area = sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(flat, flat[1:] + flat[:1]))
            require(area > 0, 7, f"surface {i}: a polygon that runs clockwise")


def is_mirror(scene, surface):
    material = scene.materials[scene.surfaces[surface].material]
    return material.reflection == Vlf.Reflection.mirror


def f32(number):
    return struct.unpack("<f", struct.pack("<f", number))[0]


def grid(scene, record, surface):
    """Columns and rows of the texels of a diffuse surface."""
    edge = f32(f32(2 / record.resolution) * f32(record.texel_cells))
    # Lengths are positive, so that halves away from zero are halves upwards.
    plane = scene.surfaces[surface]
    return [max(1, math.floor(f32(x * 2**plane.fineness / edge) + 0.5)) for x in plane.extent]


def texels(scene, record):
    """The surface of each texel, by the texel's number."""
    surfaces = range(len(scene.surfaces))
    diffuse = [s for s in surfaces if not is_mirror(scene, s)]
    mirrors = [s for s in surfaces if is_mirror(scene, s)]
    return [s for s in diffuse for _ in range(math.prod(grid(scene, record, s)))] + mirrors


def check_tile_map(tiles, name):
    first = tiles.first
    ends = first[0] == 0 and first[-1] == tiles.num_entries
    rises = all(a <= b for a, b in zip(first, first[1:]))
    require(ends and rises, 7, f"{name}: entries of tiles overlap or are left out")
    for a, b in zip(first, first[1:]):
        held = tiles.surface[a:b]
        rises = all(x < y for x, y in zip(held, held[1:]))
        require(rises, 7, f"{name}: surfaces {held} of a tile do not rise")
    values = 0
    for e in range(tiles.num_entries):
        mask = mask_of(tiles, e)
        why = f"{name}: entry {e} covers no cell, or one that its tile does not have"
        require(0 < mask < 1 << tiles.tile**2, 7, why)
        for slot in (2 * e, 2 * e + 1):
            why = f"{name}: values of slot {slot} begin at {tiles.value[slot]}, not at {values}"
            require(tiles.value[slot] == values, 7, why)
            values += [0, 1, mask.bit_count(), 0][tiles.state[slot].value]
    require(values == tiles.num_values, 7, f"{name}: {tiles.num_values} values, not {values}")


def check_textured(tiles, name, in_pack, scene):
    """That only diffuse surfaces of packs are textured."""
    for slot, state in enumerate(tiles.state):
        if state == Vlf.State.textured:
            require(in_pack, 7, f"{name}: slot {slot} is textured, not in a pack")
            surface = tiles.surface[slot // 2]
            require(not is_mirror(scene, surface), 7, f"{name}: mirror {surface} is textured")


def mask_of(tiles, entry):
    """The covered cells of an entry, as one number of m m bits."""
    words = tiles.words_per_mask
    return sum(w << 64 * i for i, w in enumerate(tiles.mask[words * entry : words * (entry + 1)]))
