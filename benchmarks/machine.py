"""What a benchmark ran on: processor, memory, system, versions, commit."""

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("numpy", "scipy", "scikit-fem", "scikit-sparse")


def describe() -> str:
    """One Markdown paragraph."""
    packages = ", ".join(f"{name} {_version(name)}" for name in PACKAGES)
    threads = os.environ.get("OMP_NUM_THREADS", "unset")
    return (
        f"Machine: {_processor()}, {os.cpu_count()} cores, {_memory_gb():.0f} GB, {platform.system()} "
        f"{platform.release()}, Python {platform.python_version()}; OMP_NUM_THREADS = {threads}, load average at the "
        f"end {os.getloadavg()[1]:.1f} (1 is this benchmark). Versions: {packages}. Commit {_commit()}."
    )


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    names = [line.split(":")[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _memory_gb() -> float:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30


def _commit() -> str:
    git = ["git", "-C", str(ROOT)]
    commit = subprocess.run([*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    # What benchmarks write is in docs and in the README: it is no change of what they measure.
    code = [*git, "status", "--porcelain", "-uno", "--", ".", ":!docs", ":!*.md"]
    changed = subprocess.run(code, capture_output=True, text=True, check=False)
    return commit.stdout.strip() + (" with uncommitted changes" if changed.stdout.strip() else "")
