"""What a figure was measured on."""

import subprocess
import sys

import numpy as np

SCRIPT = "from service.machine import peak_memory_gb; print(peak_memory_gb())"


def test_peak_memory_is_not_that_of_whoever_started_the_process():
    ballast = np.ones(100_000_000)  # 0.8 GB
    told = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True).stdout
    assert 0.005 < float(told) < 0.5
    assert ballast[-1] == 1
