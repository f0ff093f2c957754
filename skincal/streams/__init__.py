"""From bytes to paired samples: links, reader threads, decoders, clocks and pairing; `intake.Intake` is the facade."""
