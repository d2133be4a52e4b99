"""Imported by a worker before its first task: the first worker that imports it leaves at once, as at its lifetime."""

import os
from pathlib import Path

TOKEN = Path(os.environ["YESNT_TEST_LEAVE"])
if TOKEN.exists():
    TOKEN.unlink()
    os._exit(1)
