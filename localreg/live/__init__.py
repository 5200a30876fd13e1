"""The live side: from running trackers to poses in the hands of listeners."""
