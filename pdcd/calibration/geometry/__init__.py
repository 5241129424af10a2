"""Where projector, mask and camera lie: dots, stripes, maps fitted to them."""
