"""Light through the canister: cameras, refraction in closed form, and the fast projection of water points."""
