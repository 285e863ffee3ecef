"""Print the set-up commands of README.md, one a line, so that .ci/run calls what users read."""

import re
import sys
from pathlib import Path

readme = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
setup = readme.split("## Set-up", 1)[1].split("\n## ", 1)[0]
commands = [c.strip() for c in re.findall(r"```sh\n(.*?)\n```", setup, flags=re.DOTALL)]
if len(commands) != 2 or any("\n" in c for c in commands):
    sys.exit(f"README.md, Set-up: expected two commands of one line, found {len(commands)}")
print("\n".join(commands))
