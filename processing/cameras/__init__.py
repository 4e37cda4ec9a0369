"""Where cameras stand and how they see: boards, calibration, adjustment, rectification."""
