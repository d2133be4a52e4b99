"""What the stage's sets cost to render, from the records of their jobs: processor minutes, and the wall on two cores.

    python tests/benchmarks/stage_cost.py STAGE [--cores 2]

STAGE is the folder of `yesnt stage`. Every record tells the processor seconds of its Blender; sets that are only
rendered in part are counted up to the whole by the mean of what is there (and marked).
"""

import argparse
import json
from collections import defaultdict
from pathlib import Path

from yesnt.capture_stage.jobs import SETS, render_jobs


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stage", type=Path)
    parser.add_argument("--cores", type=int, default=2)
    options = parser.parse_args()
    spent = defaultdict(dict)
    for path in options.stage.glob("*/*/stage/*.json"):
        receipt = json.loads(path.read_text())
        spent[receipt["job"]["set_name"]][receipt["key"]] = receipt.get("cpu_seconds") or 0.0
    total = 0.0
    for name in SETS:
        keys = [job.key for job in render_jobs(name)]
        known = [spent[name][key] for key in keys if key in spent[name]]
        if not known:
            print(f"{name:10s} nothing rendered")
            continue
        minutes = sum(known) / len(known) * len(keys) / 60
        total += minutes if name != "embedded" else 0
        part = "" if len(known) == len(keys) else f"  (counted up from {len(known)} of {len(keys)} jobs)"
        print(f"{name:10s} {minutes:6.1f} processor minutes{part}")
    wall = total / options.cores
    print(f"all but the embedded shot: {total:.0f} processor minutes, {wall:.0f} on {options.cores} cores")


if __name__ == "__main__":
    main()
