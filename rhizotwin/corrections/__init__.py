"""Manual corrections of a result: their log, and the corrected shape, volume and traits."""
