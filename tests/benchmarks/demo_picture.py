"""The README's picture: one frame of a finished demo through the stages, as the report shows it.

yesnt demo demo && python tests/benchmarks/demo_picture.py demo 1013 docs/images/demo.png
"""

import sys
from pathlib import Path

from yesnt.io.pictures.png import png_bytes
from yesnt.report.pictures import stages_of
from yesnt.runtime.session import Session


def main(shot, frame, out):
    Path(out).write_bytes(png_bytes(stages_of(Session(shot), int(frame))))


if __name__ == "__main__":
    main(*sys.argv[1:])
