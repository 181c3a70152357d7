"""The board of turntable and lights, which speaks Marlin: from bytes to angles and levels."""
