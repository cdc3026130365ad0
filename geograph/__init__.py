"""Factor-graph smoothing for passive geolocation."""
