"""Laboratory console: web page and REST API that control the rig, its scans and their reconstructions."""
