"""Features by their names, today's and older ones: what could change samples behind one's back and
is set plain, and what goes by several names, the first that a camera has."""

PLAIN_WORDS = (
    ("AcquisitionMode", "Continuous"),
    ("ExposureAuto", "Off"),
    ("GainAuto", "Off"),
    ("BlackLevelAuto", "Off"),
    ("BalanceWhiteAuto", "Off"),
    ("TestPattern", "Off"),
    ("TestImageSelector", "Off"),
    ("GainSelector", "AnalogAll"),
    ("GainSelector", "All"),
    ("BlackLevelSelector", "All"),
    ("TriggerOverlap", "Off"),
)
"""What is chosen, where the camera has it."""
PLAIN_SWITCHES = (
    "AcquisitionFrameRateEnable",
    "AcquisitionFrameRateEnabled",
    "GammaEnable",
    "GammaEnabled",
    "LUTEnable",
    "SharpeningEnable",
    "NoiseReductionEnable",
    "DefectCorrectionEnable",
    "ColorTransformationEnable",
    "ReverseX",
    "ReverseY",
    "ChunkModeActive",
)
"""What is switched off."""
PLAIN_ONES = (
    "Gamma",
    "BinningHorizontal",
    "BinningVertical",
    "DecimationHorizontal",
    "DecimationVertical",
)
"""What is set to 1."""
TIME_FEATURES = ("ExposureTime", "ExposureTimeAbs")
GAIN_FEATURES = ("Gain", "GainAbs")
START_SELECTORS = ("FrameStart", "FrameBurstStart", "AcquisitionStart")
