"""Pins numerical libraries to one thread: a worker runs one task at a time, on one core."""

from __future__ import annotations

import sys

THREAD_VARIABLES = (
    "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "BLOSC_NTHREADS", "OPENIMAGEIO_THREADS", "OPENEXR_THREADS",
)  # fmt: skip
"""Environment variables that set the thread counts of libraries; a library reads its own once, when it is imported."""


def pin_threads() -> dict[str, int]:
    """Sets every library that this process has imported to one thread.

    Libraries that are not imported yet are left to the environment variables above, so that nothing is imported here.
    The environment is not changed: the process may be a user's notebook or a test.

    Returns:
        library -> thread count as the library reports it (OpenEXR reports 0: none beside the caller's own).
    """
    counts: dict[str, int] = {}
    if (torch := sys.modules.get("torch")) is not None:
        torch.set_num_threads(1)
        counts["torch"] = torch.get_num_threads()
    if (numba := sys.modules.get("numba")) is not None:
        numba.set_num_threads(1)
        counts["numba"] = numba.get_num_threads()
    if (cv2 := sys.modules.get("cv2")) is not None:
        cv2.setNumThreads(1)
        counts["opencv"] = cv2.getNumThreads()
    if (oiio := sys.modules.get("OpenImageIO")) is not None:
        oiio.attribute("threads", 1)
        oiio.attribute("exr_threads", -1)  # -1: none beside the caller's own
        counts["openimageio"] = oiio.get_int_attribute("threads")
    if (openexr := sys.modules.get("OpenEXR")) is not None:
        openexr.set_global_thread_count(0)  # 0: none beside the caller's own
        counts["openexr"] = openexr.global_thread_count()
    return counts
