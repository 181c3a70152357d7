"""The laboratory console: a web page and a REST API that control the rig, its scans and their reconstructions."""
