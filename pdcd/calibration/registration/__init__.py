"""Where light and mask meet: equal stripes on both panels."""
