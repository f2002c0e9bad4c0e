"""Six systems with what the authors' toolbox computes for them; see data/README.md."""

import json
from pathlib import Path

_DATA = Path(__file__).with_name("data") / "hcs_general_reference.json"
SYSTEMS = {system["name"]: system for system in json.loads(_DATA.read_text(encoding="utf-8"))["systems"]}
