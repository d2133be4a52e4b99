"""How much of the error against a set's truth is the truth's own noise: the same frame rendered with many samples.

    python tests/benchmarks/relight_truth.py render SET SUBJECT FRAME OUT --samples 512    # needs Blender
    python tests/benchmarks/relight_truth.py judge STAGE/SET/SUBJECT OUT/SET/SUBJECT FRAME

`judge`, display PSNR inside the matte by map: the set's truth against the clean one (which no relighting can beat by
much when judged by the noisy one), then standard relighting with true materials against each, from the set's plate and
from the clean plate.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from relight_ladder import STANDARD, load, psnr

from yesnt.relight import EnvMap, prepare_capture, prepare_relight, relight_frame


def render_clean(options):
    """One frame of a set under all its lights, with more samples than the set has."""
    from yesnt.capture_stage.jobs import render_jobs
    from yesnt.capture_stage.render import render
    from yesnt.capture_stage.tools import find_tools

    job = next(j for j in render_jobs(options.set) if j.subject == options.subject and options.frame in j.frames)
    job = replace(job, frames=(options.frame,), samples=options.samples)
    receipt = render(job, options.out, find_tools(options.out / "cache"))
    print(f"{receipt.rendered} pictures, {receipt.seconds:.0f} s")


def judge(options):
    """Prints a row for each pair of pictures."""
    frame = options.frame
    maps = sorted(p.name.removeprefix("relit_").split(".")[0] for p in (options.clean / "truth").glob("relit_*.exr"))
    envs = {n: EnvMap.open(options.clean / "env" / f"{n}.exr") for n in [*maps, "capture"]}
    captured = prepare_capture(envs["capture"], STANDARD)
    (noisy, proxy, noisy_truth), (clean, _, clean_truth) = (load(p, frame, maps) for p in (options.shot, options.clean))
    matte = clean.surface.opacity > 0.99
    rows = {"the set's truth against the clean one": [psnr(noisy_truth[n], clean_truth[n], matte) for n in maps]}
    for name, inputs in (("the set's plate", noisy), ("the clean plate", clean)):
        relit = {
            n: relight_frame(inputs, prepare_relight(envs[n], STANDARD), captured, proxy, STANDARD).radiance
            for n in maps
        }
        for against, truth in (("the set's truth", noisy_truth), ("the clean truth", clean_truth)):
            rows[f"relit from {name} against {against}"] = [psnr(relit[n], truth[n], matte) for n in maps]
    print(f"frame {frame}; dB by map {maps}, mean")
    for name, values in rows.items():
        print(f"{name:52s} " + "  ".join(f"{v:6.2f}" for v in [*values, np.mean(values)]))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True)
    verb = verbs.add_parser("render")
    verb.add_argument("set")
    verb.add_argument("subject")
    verb.add_argument("frame", type=int)
    verb.add_argument("out", type=Path)
    verb.add_argument("--samples", type=int, default=512)
    verb.set_defaults(run=render_clean)
    verb = verbs.add_parser("judge")
    verb.add_argument("shot", type=Path)
    verb.add_argument("clean", type=Path)
    verb.add_argument("frame", type=int)
    verb.set_defaults(run=judge)
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    main()
