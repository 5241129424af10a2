"""How well the projector's light meets the mask: equal stripes on both panels."""
