"""Light through the canister: cameras, refraction in closed form, and fast projection of points in the water."""
