"""What the bench scripts share that hold pictures against references: which pictures there are, baking
for them, and the measures.

A folder of references has `refs/ID.json`, cameras that also name their `scene` (a path from the folder)
and their `reference` (an EXR beside them), `refs/noise.csv` with the references' own errors, and
`timing.csv` with a path tracer's seconds and errors."""

import csv
import datetime
import hashlib
import json
import os
import shutil
import subprocess
from pathlib import Path

from measure import ROOT, RUNS, build, bytes_below, machine, run

# What the quality presets promise of a picture: reference, then relMSE with `preview` and with `final`.
# Where a reference's own noise is larger than what `final` promises, the noise is what is promised.
TARGETS = {
    "mcguire_cornell_original__a": (2e-3, 7e-4),
    "boxes_224__b": (2e-3, 7e-4),
    "parallel_squares__a": (2e-3, 7e-4),
    "office__a": (8e-3, 3e-3),
    "mcguire_cornell_mirror__a": (8e-3, 3e-3),
    "mirror_corridor__a": (8e-3, 3e-3),
    "metal_sphere_caustic__a": (3e-2, 1e-2),
    "ring_caustic_146__a": (3e-2, 1e-2),
}
MOST_BLOCK8 = 1e-3
MOST_RATIO = 5e-3
# Seconds that a bake may take on two cores.
MOST_SECONDS = {"office__a": (30, 300)}
# What `--method field` may have of the error of `trace`, where nothing is a mirror.
MOST_FIELD = 4
DIFFUSE = ["furnace__a", "mcguire_cornell_original__a", "parallel_squares__a"]

# Small scenes, one for each kind of light.
QUICK = ["mcguire_cornell_original__a", "parallel_squares__a", "ring_caustic_146__a"]

COLUMNS = (
    "date,machine,revision,reference,configuration,options,method,samples,directions,resolution,"
    "perturbations,cycles,bake_s,bake_cpu_s,peak_bytes,field_bytes,render_s,render_cpu_s,rmse,relmse,"
    "relmse_trimmed,block8,ratio,nonfinite,noise,estimate,load"
).split(",")


def split_at_dashes(words):
    """The words before `--` and those behind it."""
    at = words.index("--") if "--" in words else len(words)
    return words[:at], words[at + 1 :]


class Reference:
    """A picture that is known, and where it was taken."""

    def __init__(self, folder, camera, noise):
        described = json.loads(camera.read_text())
        self.name = camera.stem
        self.camera = camera
        self.scene = folder / described["scene"]
        self.picture = camera.parent / described["reference"]
        self.noise = noise.get(self.name, 0.0)


def references(folder, names=None):
    """The references in a folder, those with promises first; or the named ones, in that order."""
    folder = Path(folder)
    with open(folder / "refs" / "noise.csv", newline="") as file:
        noise = {row["id"]: float(row["relmse_ref"]) for row in csv.DictReader(file)}
    found = {c.stem: c for c in sorted((folder / "refs").glob("*.json"))}
    if names is None:
        # Beyond the promises only what bakes within minutes.
        others = [n for n in found if n.startswith("furnace")]
        names = [n for n in TARGETS if n in found] + others
    unknown = [n for n in names if n not in found]
    if unknown:
        raise SystemExit(f"no reference {', '.join(unknown)}; there are {', '.join(found)}")
    return [Reference(folder, found[n], noise) for n in names]


def program(folder):
    """The program, built and then copied into a folder, so that no later build changes it during a run."""
    return Path(shutil.copy2(build(), folder))


class Bakery:
    """Bakes fields in a folder. Those that stay there are taken as they are the next time, if nothing has
    changed that a bake depends on: the scene, the options, the sources but those that only look."""

    def __init__(self, vlf, folder, keep):
        self.vlf, self.folder, self.keep = vlf, Path(folder), keep
        self.sources = hashlib.sha256()
        for source in sorted((ROOT / "src").rglob("*.rs")):
            if source.relative_to(ROOT / "src").parts[0] not in ("look", "cli", "verify", "plan"):
                self.sources.update(source.read_bytes())

    def bake(self, scene, options):
        """A field of a scene: what it took and what it says of itself, and its path as `field`."""
        key = self.sources.copy()
        for file in sorted(scene.parent.glob("*.obj")) + sorted(scene.parent.glob("*.mtl")):
            key.update(file.read_bytes())
        key.update("\0".join([scene.name, *options]).encode())
        field = self.folder / f"{scene.stem}-{key.hexdigest()[:16]}.field"
        record = field.with_suffix(".json")
        if record.exists() and field.exists():
            return dict(json.loads(record.read_text()), field=field)
        self.drop(field)
        result = run([self.vlf, "bake", scene, "-o", field, "--json", *options])
        said = json.loads(result.pop("out"))
        info = json.loads(run([self.vlf, "info", field, "--json"])["out"])
        result["estimate"] = info["error"]["relmse"]
        result.update(
            parameters=said["parameters"], cycles=said["cycles"], bytes=bytes_below(field)
        )
        record.write_text(json.dumps(result))
        return dict(result, field=field)

    def done(self, baked):
        """Lets go of a field, unless fields are kept."""
        if not self.keep:
            self.drop(baked["field"])

    def drop(self, field):
        """Removes a field, its record and its pictures."""
        shutil.rmtree(field, ignore_errors=True)
        for beside in field.parent.glob(f"{field.stem}.*"):
            beside.unlink()


def score(vlf, baked, reference, method, samples, options, configuration=""):
    """Takes the reference's picture of a field and measures it: a row of COLUMNS."""
    picture = baked["field"].with_suffix(f".{method}.exr")
    what = ["--camera", reference.camera, "--method", method, "--samples", samples]
    took = run([vlf, "render", baked["field"], "-o", picture, *what])
    against = run([vlf, "compare", picture, reference.picture, "--json"])
    measures = json.loads(against["out"])
    parameters = baked["parameters"]
    return {
        "date": datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%d %H:%M"),
        "machine": machine(),
        "revision": revision(),
        "reference": reference.name,
        "configuration": configuration,
        "options": " ".join(options),
        "method": method,
        "samples": samples,
        "directions": parameters["directions"],
        "resolution": parameters["resolution"],
        "perturbations": " ".join(map(str, parameters["perturbations"])),
        "cycles": baked["cycles"],
        "bake_s": round(baked["seconds"], 2),
        "bake_cpu_s": round(baked["cpu"], 2),
        "peak_bytes": baked["peak"],
        "field_bytes": baked["bytes"],
        "render_s": round(took["seconds"], 3),
        "render_cpu_s": round(took["cpu"], 3),
        "rmse": measures["rmse"],
        "relmse": measures["relmse"],
        "relmse_trimmed": measures["relmse_trimmed"],
        "block8": measures["block8"],
        "ratio": measures["ratio"],
        "nonfinite": measures["nonfinite_pixels"],
        "noise": reference.noise,
        "estimate": baked["estimate"],
        "load": round(os.getloadavg()[0], 1),
    }


def revision():
    """The commit, with a mark when there are changes beside it."""
    command = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return said.stdout.strip()


def append(path, rows):
    """Adds rows to a CSV file of COLUMNS."""
    path.parent.mkdir(exist_ok=True)
    is_new = not path.exists()
    with open(path, "a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        if is_new:
            writer.writeheader()
        writer.writerows(rows)


def runs_path(name):
    """Where a bench of today keeps something."""
    today = datetime.datetime.now(datetime.timezone.utc).date()
    return RUNS / f"{today}-{name}"
