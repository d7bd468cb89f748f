"""What the bench scripts share: running the program, and what it takes of time, memory and disk."""

import json
import os
import platform
import subprocess
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RUNS = ROOT / "benches" / "runs"
SAMPLE_SECONDS = 0.02


def build(target="target", flags=""):
    """Builds the program with these compiler flags; returns where it is."""
    env = dict(os.environ, CARGO_TARGET_DIR=str(ROOT / target))
    if flags:
        env["RUSTFLAGS"] = flags
    command = ["cargo", "build", "--release", "--quiet", "--bin", "vlf"]
    subprocess.run(command, cwd=ROOT, env=env, check=True)
    return ROOT / target / "release" / "vlf"


def run(command):
    """Runs a command to its end: seconds, CPU seconds, peak RssAnon in bytes, and its output."""
    before = os.times()
    began = time.monotonic()
    process = subprocess.Popen(
        [str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    peak = 0
    while process.poll() is None:
        peak = max(peak, anonymous(process.pid))
        time.sleep(SAMPLE_SECONDS)
    out, err = process.communicate()
    seconds = time.monotonic() - began
    after = os.times()
    if process.returncode != 0:
        raise SystemExit(f"{' '.join(map(str, command))}: exit {process.returncode}\n{err}")
    cpu = after.children_user + after.children_system
    cpu -= before.children_user + before.children_system
    return {"seconds": seconds, "cpu": cpu, "peak": peak, "out": out}


def anonymous(pid):
    """Anonymous memory of a process, in bytes; 0 when it is gone."""
    try:
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("RssAnon:"):
                return 1024 * int(line.split()[1])
    except OSError:
        pass
    return 0


def bytes_below(path):
    """Bytes of all files below a folder."""
    return sum(f.stat().st_size for f in Path(path).rglob("*") if f.is_file())


def machine():
    """The machine, as far as it matters for figures."""
    model = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.split(":", 1)[1].strip()
                break
    except OSError:
        pass
    return f"{os.cpu_count()} cores of {model}, {platform.system()} {platform.release()}"


def mib(count):
    """Bytes in MiB, as text."""
    return f"{count / 2**20:.1f} MiB"


def keep(name, record):
    """Keeps the raw results of a run beside those of others."""
    RUNS.mkdir(exist_ok=True)
    stamp = time.strftime("%Y-%m-%d-%H%M", time.gmtime())
    path = RUNS / f"{stamp}-{name}.json"
    path.write_text(json.dumps({"machine": machine(), **record}, indent=1) + "\n")
    print(f"kept in {path.relative_to(ROOT)}")
