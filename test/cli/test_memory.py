"""Memory of freed images is used again."""

from __future__ import annotations

import subprocess
import sys

CHURN = """
import resource, sys
from turbseg_ros.cli.memory import keep_large_buffers
if "keep" in sys.argv:
    keep_large_buffers()

def frame():
    # As a message is received: each 1080p colour image is copied twice.
    return [bytearray(1920 * 1080 * 3) for _ in range(3)]

for number in range(13):
    if number == 3:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    frame()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def page_faults(*arguments: str) -> int:
    done = subprocess.run(
        [sys.executable, "-c", CHURN, *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return int(done.stdout)


def test_a_frame_takes_the_memory_of_the_one_before():
    pages_of_ten_frames = 10 * 3 * 1920 * 1080 * 3 // 4096
    assert page_faults("keep") < pages_of_ten_frames / 20
    # Where this fails the C library has learnt it by itself.
    assert page_faults() > pages_of_ten_frames / 2
