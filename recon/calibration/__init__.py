"""Where the cameras and the canister were, from the markers of all pictures together and the canister's own edges."""
