"""The open session: controller, opening, recording, previews of links. No widgets."""
