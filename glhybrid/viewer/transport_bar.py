"""What plays a clip: a bar at the bottom of the window, drawn where the scene has animations."""

from glhybrid.viewer.controls import Controls
from glhybrid.viewer.gui import Gui
from glhybrid.viewer.session import Session

HEIGHT = 46


def draw(gui: Gui, session: Session, controls: Controls, size: tuple[int, int], scale: float) -> None:
    """The bar at the bottom, for this frame. size: of what is beside the panel, pixels. scale: of text."""
    imgui, transport, (wide, high), s = gui.imgui, session.transport, size, scale
    flags = imgui.WindowFlags_
    imgui.set_next_window_pos((0, high - HEIGHT * s))
    imgui.set_next_window_size((wide, HEIGHT * s))
    imgui.set_next_window_bg_alpha(0.85)
    imgui.begin("transport", None, flags.no_decoration | flags.no_move | flags.no_saved_settings)
    if imgui.button("Pause" if transport.playing else "Play", (58 * s, 0)):
        controls.play()
    imgui.same_line()
    clips = ["at rest", *(a.name or f"clip {i}" for i, a in enumerate(session.scene.animations))]
    imgui.set_next_item_width(150 * s)
    changed, index = imgui.combo("##clip", transport.clip + 1, clips)
    if changed:
        transport.choose(session.scene, index - 1)
        session.edited()
    imgui.same_line()
    imgui.set_next_item_width(max(wide - 470 * s, 60 * s))
    text = f"%.3f of {transport.end:.2f} s"
    changed, time = imgui.slider_float("##time", transport.time, 0.0, max(transport.end, 1e-3), text)
    if changed and transport.clip >= 0:
        transport.seek(time)
    imgui.same_line()
    imgui.set_next_item_width(80 * s)
    curve = imgui.SliderFlags_.logarithmic
    changed, speed = imgui.slider_float("##speed", transport.speed, 0.1, 4.0, "%.2f x", curve)
    transport.speed = speed if changed else transport.speed
    imgui.same_line()
    transport.loop = imgui.checkbox("loop", transport.loop)[1]
    imgui.end()
