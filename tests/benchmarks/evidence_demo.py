"""What the evidence adds to a run, in processor seconds of the kernels: `yesnt demo FOLDER`, then

    python tests/benchmarks/evidence_demo.py FOLDER

Without the evidence a run has all other tasks of the run, so that one run tells both.
"""

import json
import sys
from collections import defaultdict
from pathlib import Path


def main(folder):
    spent = defaultdict(float)
    for line in (folder / "out" / "run" / "events.jsonl").read_text().splitlines():
        event = json.loads(line)
        if event.get("event") == "done":
            spent[event["stage"]] += event["kernel_processor_seconds"]
    for stage, seconds in spent.items():
        print(f"{stage:18s} {seconds:6.1f} s")
    rest = sum(spent.values()) - spent["evidence"]
    print(f"the evidence adds {100 * spent['evidence'] / rest:.0f} % to {rest:.1f} s")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
