"""Runs what needs LeRobot, in an environment that sees this one and has LeRobot on top.

LeRobot asks for an older torch, so it is installed without what it asks for, but with what it
imports by name.

    make bridge
"""

import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BRIDGE = ROOT / "build" / "bridge"
STAMP = BRIDGE / "stamp.txt"  #: written last, so only a finished environment has it
PACKAGES = (
    *("lerobot==0.4.4", "transformers==4.57.6", "huggingface-hub<1", "tokenizers<0.23", "regex"),
    *("datasets==4.8.5", "multiprocess<0.70.20", "dill<0.4.1", "diffusers==0.35.2", "torchvision"),
    *("draccus==0.10.0", "pyyaml-include", "mergedeep", "typing-inspect", "toml", "xxhash", "av"),
    *("jsonlines", "einops", "deepdiff", "orderly-set", "cachebox", "termcolor", "imageio"),
    *("pyserial", "pynput", "torchcfm", "torchdiffeq", "flow_matching", "accelerate"),
)
TESTS = ("tests/bridge", "tests/robots/test_episodes.py", "tests/docs/test_snippets.py")


def set_up(python: Path) -> None:
    """Make the environment, unless it is there."""
    if STAMP.exists() and STAMP.read_text() == "\n".join(PACKAGES):
        return
    subprocess.run([sys.executable, "-m", "venv", "--clear", BRIDGE], check=True)
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    own = subprocess.run([python, "-c", ask], check=True, capture_output=True, text=True).stdout
    ours = sysconfig.get_path("purelib")
    (Path(own.strip()) / "ours.pth").write_text(f"{ours}\n{ROOT}\n")
    print("Installing LeRobot and what it imports ...", flush=True)
    install = [python, "-m", "pip", "install", "--quiet", "--no-deps", *PACKAGES]
    subprocess.run(install, check=True)
    STAMP.write_text("\n".join(PACKAGES))


def main(words: list[str]) -> int:
    """Set up, and run the tests; returns the exit status."""
    python = BRIDGE / Path(sys.executable).relative_to(sys.prefix)
    set_up(python)
    chosen = words or [*TESTS, "-k", "bridge or lerobot or torchcfm or flow_matching"]
    return subprocess.call([python, "-m", "pytest", "-q", *chosen], cwd=ROOT)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
