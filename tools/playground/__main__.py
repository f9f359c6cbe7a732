"""``python -m tools.playground PAGE`` writes the playground."""

import sys
from pathlib import Path

from tools.playground import TARGET, compiled, playground_html, target_is_installed

if not target_is_installed():
    raise SystemExit(f"no playground: rustup target add {TARGET}")
page = Path(sys.argv[1])
page.parent.mkdir(parents=True, exist_ok=True)
page.write_text(playground_html(compiled()), encoding="utf-8")
print(page)
