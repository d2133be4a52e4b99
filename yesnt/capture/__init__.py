"""The capture: its calibrated cameras, which of them measure a frame, and their pictures."""
