"""Names of features, present and older ones: features that could silently change samples and are
set to neutral values, and features with several names, of which the first that exists is used."""

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
"""Enumerations and the values that are chosen, if the camera has them."""
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
"""Features that are switched off."""
PLAIN_ONES = (
    "Gamma",
    "BinningHorizontal",
    "BinningVertical",
    "DecimationHorizontal",
    "DecimationVertical",
)
"""Features that are set to 1."""
TIME_FEATURES = ("ExposureTime", "ExposureTimeAbs")
GAIN_FEATURES = ("Gain", "GainAbs")
START_SELECTORS = ("FrameStart", "FrameBurstStart", "AcquisitionStart")
