meta:
  id: vlf
  title: Virtual light field, version 1.0
  application: vlf
  file-extension:
    - vlf
    - tiles
  license: MIT OR Apache-2.0
  ks-version: '0.11'
  endian: le
doc: |
  Every file of a virtual light field: a container of hashed chunks, and what the chunks hold.
  `README.md` beside this file is the specification; this says of it what Kaitai Struct can say. Not
  here are hashes, the order and the gaps of chunks, and rules that tie one table to another: a
  reader adds them ("How a reader validates").

  Only the preamble is read at once. The rest waits until it is asked for, so that a reader can
  check the hash of a part before anything is read from it. In the order of the README: `preamble`,
  `hashed` against `first_block_hash`, `first_block`, `directory_bytes` against its
  `directory_hash`, `directory`, and of each entry `stored` against its `chunk_hash`, `content`.

  A chunk of another codec has no `content`. Decompress `stored`, put planes together as the README
  says, and read the result as the type that `content` names for the chunk's kind, with this file as
  its root.
doc-ref: README.md
seq:
  - id: preamble
    type: preamble
instances:
  hashed:
    pos: 0
    size: 248
    doc: What the first block's hash is of.
  first_block_hash:
    pos: 248
    type: u8
    doc: xxh3-64 of `hashed`.
  first_block:
    pos: 16
    type: first_block
  directory_bytes:
    pos: 256
    size: 64 * first_block.num_chunks
    doc: What the directory's hash is of.
  directory:
    pos: 256
    type: directory_entry
    repeat: expr
    repeat-expr: first_block.num_chunks
types:
  preamble:
    doc: |
      Bytes 0 to 15 of the first block. In a file of another major version nothing behind them is
      to be looked at.
    doc-ref: README.md#first-block
    seq:
      - id: magic
        contents: [0x89, 'VLF', 0x0d, 0x0a, 0x1a, 0x0a]
        doc: Lines' ends and an end of text, so that a copy in text mode shows.
      - id: byte_order
        type: u4
        valid: 0x01020304
      - id: major_version
        type: u2
        valid: 1
      - id: minor_version
        type: u2
        doc: Any. A reader goes on with a minor version that it does not know.
  features:
    doc: Sets of feature bits, of which 1.0 defines none.
    doc-ref: README.md#versions-and-features
    seq:
      - id: required_to_read
        type: u8
        valid: 0
      - id: required_to_write
        type: u8
        doc: A bit that is not known forbids to change the field, not to read it.
      - id: optional
        type: u8
        doc: |
          Bits that are not known are ignored. Bit 0, of packs: total maps have no diffuse surfaces.
  first_block:
    doc: Bytes 16 to 255 of the first block.
    doc-ref: README.md#first-block
    seq:
      - id: features
        type: features
      - id: file_kind
        type: u4
        enum: file_kind
        valid:
          in-enum: true
      - id: num_directions
        type: u4
        valid:
          any-of: [3, 9, 33, 129, 513, 2049, 8193, 32769, 131073, 524289]
        doc: The number of lines, l.
        doc-ref: README.md#lines
      - id: resolution
        type: u4
        valid:
          min: 1
          max: 8192
        doc: Cells along an edge of a parallel subfield, N.
      - id: tile
        type: u4
        valid:
          expr: _ >= 1 and _ <= 256 and resolution % _ == 0
        doc: Cells along an edge of a tile, m.
      - id: exponent
        type: s4
        valid:
          min: -100
          max: 100
        doc: A stored f16 is to be multiplied by 2^exponent.
      - id: num_surfaces
        type: u4
        valid:
          max: 16777216
      - id: field
        size: 16
        doc: xxh3-128 of the record's beginning; see `identity_bytes` of `record`.
      - id: generation
        type: u4
      - id: direction
        type: u4
        valid:
          expr: _ < num_directions or _ == 0xffffffff
        doc: The line that the file belongs to, or 0xffffffff for none.
      - id: num_chunks
        type: u8
      - id: directory_hash
        type: u8
        doc: xxh3-64 of `directory_bytes`.
      - id: len_file
        type: u8
      - id: reserved
        type: u1
        repeat: expr
        repeat-expr: 136
        valid: 0
      - id: first_block_hash
        type: u8
  directory_entry:
    doc: Where a chunk lies and what it is.
    doc-ref: README.md#directory
    seq:
      - id: kind
        type: u4
        enum: chunk_kind
        valid:
          in-enum: true
      - id: cycle
        type: u4
        doc: Cycle or generation.
      - id: direction
        type: u4
        valid:
          expr: _ < _root.first_block.num_directions or _ == 0xffffffff
        doc: The line, or 0xffffffff for none.
      - id: codec
        type: u4
        enum: codec
        valid:
          in-enum: true
      - id: ofs_stored
        type: u8
        valid:
          expr: _ % 64 == 0
      - id: len_stored
        type: u8
      - id: len_raw
        type: u8
        valid:
          expr: >-
            (codec != codec::raw or _ == len_stored)
            and _ <= (kind == chunk_kind::record ? 67108864 : 4294967296)
      - id: chunk_hash
        type: u8
        doc: |
          xxh3-64 of `stored`, seeded with the xxh3-64 of the field's identity, `kind`, `cycle` and
          `direction`.
      - id: reserved
        type: u1
        repeat: expr
        repeat-expr: 16
        valid: 0
    instances:
      ofs_padding:
        value: ofs_stored + len_stored
      stored:
        io: _root._io
        pos: ofs_stored
        size: len_stored
        doc: The bytes as they are in the file. Check `chunk_hash` before anything else.
      padding:
        io: _root._io
        pos: ofs_padding
        type: u1
        repeat: expr
        repeat-expr: (64 - ofs_padding % 64) % 64
        valid: 0
        doc: Up to where the next chunk begins or the file ends.
        doc-ref: README.md#container
      content:
        io: _root._io
        pos: ofs_stored
        size: len_stored
        if: codec == codec::raw
        type:
          switch-on: kind
          cases:
            'chunk_kind::record': record
            'chunk_kind::scene': scene
            'chunk_kind::total_textures': texture_map
            'chunk_kind::current_textures': texture_map
            'chunk_kind::half_textures': texture_map
            'chunk_kind::sums': sums
            'chunk_kind::unshot_tiles': tile_map
            'chunk_kind::arrived_tiles': tile_map
            'chunk_kind::total_tiles': tile_map
        doc: What a raw chunk holds.
  record:
    doc: What a field is and how far its bake has come.
    doc-ref: README.md#the-record
    seq:
      - id: revision
        type: u4
      - id: num_directions
        type: u4
        valid: _root.first_block.num_directions
      - id: resolution
        type: u4
        valid: _root.first_block.resolution
      - id: tile
        type: u4
        valid: _root.first_block.tile
      - id: has_cycles
        type: u1
        valid:
          max: 1
      - id: cycles
        type: u4
        if: has_cycles == 1
        doc: Cycles to run; none means until the unshot fraction is reached.
      - id: unshot_fraction
        type: f8
      - id: num_perturbations
        type: u8
      - id: perturbations
        type: u4
        repeat: expr
        repeat-expr: num_perturbations
      - id: thinned
        type: u4
        valid:
          max: 9
        doc: Later cycles have only the lines of a lattice with steps 2^thinned times as long.
      - id: texel_cells
        type: f8
        valid:
          min: 0.1
          max: 100
      - id: refined
        type: f8
        valid:
          min: 1
          max: 64
        doc: Most times as many texels as a fineness of 0 everywhere would give.
      - id: supersample
        type: u1
        valid:
          max: 1
      - id: filter
        type: u4
        valid:
          max: 64
      - id: one_sided
        type: u1
        valid:
          max: 1
      - id: transfer
        type: u4
        enum: transfer
        valid:
          in-enum: true
      - id: specular
        type: u4
        enum: specular
        valid:
          in-enum: true
      - id: resample
        type: u1
        valid:
          min: 'specular == specular::trace ? 1 : 0'
          max: 1
      - id: target_error
        type: f8
        valid:
          min: 0
          max: 1
      - id: scene_hash
        size: 16
        doc: xxh3-128 of the scene chunk when decoded.
      - id: phase
        type: u4
        enum: phase
        valid:
          in-enum: true
      - id: cycle
        type: u4
      - id: len_done
        type: u8
        valid: (num_directions + 7) / 8
      - id: done
        size: len_done
        doc: A bit a line, low bit first.
      - id: sequence
        type: u8
      - id: has_sums
        type: u1
        valid:
          max: 1
      - id: num_ledgers
        type: u8
      - id: ledgers
        type: ledger
        repeat: expr
        repeat-expr: num_ledgers
      - id: num_grids
        type: u8
      - id: grids
        type: u4
        repeat: expr
        repeat-expr: num_grids
      - id: relmse
        type: f8
      - id: noise
        type: f8
      - id: num_worst
        type: u8
        valid:
          max: 64
      - id: worst
        type: surface_error
        repeat: expr
        repeat-expr: num_worst
      - id: seconds
        type: f8
      - id: fragments
        type: u8
      - id: gathers
        type: u8
      - id: holes
        type: u8
      - id: bytes_written
        type: u8
      - id: entries
        type: u8
      - id: hits
        type: u8
      - id: misses
        type: u8
      - id: evictions
        type: u8
      - id: redundant
        type: u8
      - id: bytes
        type: u8
      - id: peak
        type: u8
      - id: wait
        type: f8
      - id: has_sync
        type: u1
        valid:
          max: 1
      - id: sync
        type: f8
        if: has_sync == 1
      - id: digest
        size: 16
      - id: end
        size: 0
        valid:
          expr: _io.eof
        doc: The record ends with the chunk.
    instances:
      len_identity:
        value: 92 + 4 * has_cycles + 4 * num_perturbations
      identity_bytes:
        pos: 0
        size: len_identity
        doc: Up to and with `scene_hash`. Their xxh3-128 is the field's identity.
        doc-ref: README.md#first-block
    types:
      surface_error:
        doc: The error of a surface.
        seq:
          - id: surface
            type: u4
          - id: relmse
            type: f8
          - id: part
            type: f8
      ledger:
        doc: Where a cycle's power went, in W.
        seq:
          - id: cycle
            type: u4
          - id: emitted
            type: f8
          - id: carried_in
            type: f8
          - id: absorbed
            type: f8
          - id: left
            type: f8
          - id: unshot_diffuse
            type: f8
          - id: unshot_mirror
            type: f8
          - id: holes
            type: f8
          - id: sampling
            type: f8
          - id: quantised
            type: f8
  scene:
    doc: Polygons and what they are made of, in the units of the unit ball.
    doc-ref: README.md#the-scene
    seq:
      - id: centre
        type: f8
        repeat: expr
        repeat-expr: 3
        valid:
          min: -1.7976931348623157e308
          max: 1.7976931348623157e308
        doc: Of the bounding ball, in the scene's own units.
      - id: radius
        type: f8
        valid:
          expr: _ > 0 and _ <= 1.7976931348623157e308
      - id: num_materials
        type: u4
      - id: materials
        type: material
        repeat: expr
        repeat-expr: num_materials
      - id: num_surfaces
        type: u4
        valid: _root.first_block.num_surfaces
      - id: surfaces
        type: surface(num_materials)
        repeat: expr
        repeat-expr: num_surfaces
      - id: images
        type: images(num_materials, num_surfaces)
        if: not _io.eof
        doc: Of textured scenes only.
      - id: end
        size: 0
        valid:
          expr: _io.eof
        doc: The scene ends with the chunk.
    types:
      material:
        seq:
          - id: len_name
            type: u4
            valid:
              max: 4096
          - id: name
            type: str
            size: len_name
            encoding: UTF-8
          - id: emitted
            type: f4
            repeat: expr
            repeat-expr: 3
            valid:
              min: 0
              max: 3.4028234663852886e38
            doc: Radiance of the front, W sr^-1 m^-2.
          - id: reflection
            type: u1
            enum: reflection
            valid:
              in-enum: true
          - id: reflectance
            type: f4
            repeat: expr
            repeat-expr: 3
            valid:
              min: 0
              max: 1
      surface:
        params:
          - id: num_materials
            type: u4
        seq:
          - id: material
            type: u4
            valid:
              expr: _ < num_materials
          - id: normal
            type: vector
          - id: origin
            type: vector
          - id: u
            type: vector
          - id: v
            type: vector
          - id: extent
            type: f4
            repeat: expr
            repeat-expr: 2
            valid:
              min: 0
              max: 3.4028234663852886e38
          - id: fineness
            type: u1
            valid:
              max: 4
            doc: Texels are 2^fineness times as many along each edge as elsewhere.
          - id: num_polygons
            type: u4
            valid:
              min: 1
          - id: polygons
            type: polygon
            repeat: expr
            repeat-expr: num_polygons
      polygon:
        seq:
          - id: num_corners
            type: u4
            valid:
              min: 3
          - id: corners
            type: vector
            repeat: expr
            repeat-expr: num_corners
      images:
        doc: Images, and where they lie.
        params:
          - id: num_materials
            type: u4
          - id: num_surfaces
            type: u4
        seq:
          - id: num_images
            type: u4
            valid:
              min: 1
          - id: images
            type: image
            repeat: expr
            repeat-expr: num_images
          - id: num_textures
            type: u4
            valid:
              max: num_materials
          - id: textures
            type: texture
            repeat: expr
            repeat-expr: num_textures
          - id: num_placements
            type: u4
            valid:
              max: num_surfaces
          - id: placements
            type: placement
            repeat: expr
            repeat-expr: num_placements
      image:
        seq:
          - id: width
            type: u4
            valid:
              min: 1
          - id: height
            type: u4
            valid:
              min: 1
          - id: pixels
            size: 3 * width * height
            doc: Red, green, blue of each, sRGB, row by row from the top.
      texture:
        doc: The image of a diffuse material.
        seq:
          - id: material
            type: u4
            valid:
              expr: _ < _parent.num_materials
          - id: image
            type: u4
            valid:
              expr: _ < _parent.num_images
          - id: clamp
            type: u1
            valid:
              max: 3
            doc: Bit 0 along rows, bit 1 across them; the image repeats where it is clear.
          - id: tint
            type: f4
            repeat: expr
            repeat-expr: 3
            valid:
              min: 0
              max: 1
      placement:
        doc: Where the image of a surface's material lies on it, in edges of the image.
        seq:
          - id: surface
            type: u4
            valid:
              expr: _ < _parent.num_surfaces
          - id: origin
            type: place
          - id: along_u
            type: place
          - id: along_v
            type: place
      place:
        seq:
          - id: xy
            type: f4
            repeat: expr
            repeat-expr: 2
            valid:
              min: -1e9
              max: 1e9
      vector:
        doc: A point of the unit ball, or a direction.
        seq:
          - id: xyz
            type: f4
            repeat: expr
            repeat-expr: 3
            valid:
              min: -3.4028234663852886e38
              max: 3.4028234663852886e38
  texture_map:
    doc: |
      Radiance of each side of each texel: value 2 t is texel t's front, 2 t + 1 its back. How many
      texels there are follows from the scene.
    doc-ref: README.md#texture-maps
    seq:
      - id: values
        type: rgb
        repeat: eos
    types:
      rgb:
        seq:
          - id: channels
            type: f4
            repeat: expr
            repeat-expr: 3
            valid:
              min: 0
              max: 3.4028234663852886e38
  tile_map:
    doc: For one line, radiance of the cells that each surface covers in each tile.
    doc-ref: README.md#tile-maps
    seq:
      - id: num_columns
        type: u4
        valid: _root.first_block.resolution / _root.first_block.tile
        doc: Tiles along an edge, n.
      - id: tile
        type: u4
        valid: _root.first_block.tile
        doc: Cells along an edge of a tile, m.
      - id: num_entries
        type: u4
        doc: E.
      - id: num_values
        type: u4
        doc: V.
      - id: first
        type: u4
        repeat: expr
        repeat-expr: num_columns * num_columns + 1
        valid:
          max: num_entries
        doc: Tile k has the entries `first[k]` up to `first[k + 1]`.
      - id: first_padding
        type: padding
      - id: surface
        type: u4
        repeat: expr
        repeat-expr: num_entries
        valid:
          expr: _ < _root.first_block.num_surfaces
      - id: surface_padding
        type: padding
      - id: value
        type: u4
        repeat: expr
        repeat-expr: 2 * num_entries
        valid:
          max: num_values
        doc: Where the values of each entry's two senses begin.
      - id: state
        type: u1
        enum: state
        repeat: expr
        repeat-expr: 2 * num_entries
        valid:
          in-enum: true
      - id: state_padding
        type: padding
      - id: mask
        type: u8
        repeat: expr
        repeat-expr: num_entries * words_per_mask
        doc: Covered cells, `words_per_mask` words an entry.
      - id: rgb
        type: u2
        repeat: expr
        repeat-expr: 3 * num_values
        valid:
          max: 0x7bff
        doc: The bits of an f16, whose sign is clear and which is finite.
      - id: rgb_padding
        type: padding
      - id: end
        size: 0
        valid:
          expr: _io.eof
        doc: The map ends with the chunk.
    instances:
      words_per_mask:
        value: (tile * tile + 63) / 64
    types:
      padding:
        doc: Up to the next multiple of 8 from the beginning of the chunk.
        seq:
          - id: bytes
            type: u1
            repeat: expr
            repeat-expr: (8 - _io.pos % 8) % 8
            valid: 0
  sums:
    doc: The state of a cycle between two commits, for the baker alone.
    doc-ref: README.md#sums
    seq:
      - id: whole
        type: tally
        doc: Of the rounds that were for all surfaces.
      - id: partial
        type: tally
        doc: Of the rounds that were for some.
      - id: num_grids
        type: u4
        repeat: expr
        repeat-expr: _root.first_block.num_surfaces
        doc: Subfields a line after which a surface had lines enough, or 0.
      - id: values
        type: value
        repeat: eos
        doc: As many as a texture map has for one half of the lines, then for the other.
    types:
      tally:
        seq:
          - id: shot_by_diffuse
            type: i128
          - id: shot_by_mirrors
            type: i128
          - id: left
            type: i128
          - id: arrived
            type: i128
            doc: At mirrors; so are the next three.
          - id: arrived_times_reflectance
            type: i128
          - id: arrived_unperturbed
            type: i128
          - id: arrived_as_stored
            type: i128
          - id: fragments
            type: i128
          - id: gathers
            type: i128
          - id: holes
            type: i128
      i128:
        seq:
          - id: low
            type: u8
          - id: high
            type: s8
      value:
        seq:
          - id: red
            type: s8
          - id: green
            type: s8
          - id: blue
            type: s8
          - id: num_lines
            type: s8
            doc: In parts of 65536, each line weighted by its shares.
enums:
  file_kind:
    1: manifest
    2: scene
    3: textures
    4: sums
    5: tiles
    6: pack
  chunk_kind:
    1: record
    2: scene
    3: total_textures
    4: current_textures
    5: sums
    6: unshot_tiles
    7: arrived_tiles
    8: total_tiles
    9: half_textures
  codec:
    0: raw
    1: zstd
    2: planes
  phase:
    0: propagating
    1: writing_totals
    2: finished
  transfer:
    0: sample
    1: clip
  specular:
    0: maps
    1: trace
  reflection:
    0: diffuse
    1: mirror
  state:
    0: dark
    1: constant
    2: one_value_a_cell
    3: textured
