"""How much light a grey level gives."""
