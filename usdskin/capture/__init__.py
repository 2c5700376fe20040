"""Capture: photographs become one calibrated omnidirectional HDR environment, as USD."""
