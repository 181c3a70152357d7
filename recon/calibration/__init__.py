"""What the pictures tell of the rig: poses from the markers, the canister's seat, and index and poses from the roots themselves."""
