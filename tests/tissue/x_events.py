"""Mouse and keys of a person on an X display, sent from another process by the display's own library."""

import ctypes
import time

SYMBOLS = {"Next": 0xFF56, "Prior": 0xFF55, "Left": 0xFF51, "Up": 0xFF52, "Right": 0xFF53, "Down": 0xFF54}
KEY_PRESS, KEY_RELEASE, BUTTON_PRESS, BUTTON_RELEASE = 2, 3, 4, 5


class KeyEvent(ctypes.Structure):
    """XKeyEvent, and XButtonEvent, which has the button in place of the key."""

    _fields_ = [
        ("type", ctypes.c_int),
        ("serial", ctypes.c_ulong),
        ("sent", ctypes.c_int),
        ("display", ctypes.c_void_p),
        ("window", ctypes.c_ulong),
        ("root", ctypes.c_ulong),
        ("subwindow", ctypes.c_ulong),
        ("time", ctypes.c_ulong),
        ("x", ctypes.c_int),
        ("y", ctypes.c_int),
        ("x_root", ctypes.c_int),
        ("y_root", ctypes.c_int),
        ("state", ctypes.c_uint),
        ("code", ctypes.c_uint),
        ("same_screen", ctypes.c_int),
        ("room", ctypes.c_long * 24),
    ]


class Person:
    """Someone at a display: moves the pointer, types and turns the wheel over the window under it."""

    def __init__(self, display):
        self._x = x = ctypes.CDLL("libX11.so.6")
        x.XOpenDisplay.restype = ctypes.c_void_p
        x.XDefaultRootWindow.argtypes = [ctypes.c_void_p]
        x.XDefaultRootWindow.restype = ctypes.c_ulong
        x.XKeysymToKeycode.argtypes = [ctypes.c_void_p, ctypes.c_ulong]
        x.XKeysymToKeycode.restype = ctypes.c_ubyte
        x.XWarpPointer.argtypes = [ctypes.c_void_p, ctypes.c_ulong, ctypes.c_ulong, *[ctypes.c_int] * 6]
        x.XFlush.argtypes = x.XCloseDisplay.argtypes = [ctypes.c_void_p]
        x.XSendEvent.argtypes = [ctypes.c_void_p, ctypes.c_ulong, ctypes.c_int, ctypes.c_long, ctypes.c_void_p]
        x.XQueryPointer.argtypes = [ctypes.c_void_p, ctypes.c_ulong, *[ctypes.c_void_p] * 7]
        self._display = x.XOpenDisplay(display.encode())
        assert self._display, f"{display} does not answer"
        self._root = x.XDefaultRootWindow(self._display)

    def move(self, x, y):
        """Move the pointer to a pixel from the upper left corner."""
        self._x.XWarpPointer(self._display, 0, self._root, 0, 0, 0, 0, x, y)
        self._x.XFlush(self._display)

    def type(self, key, times=1, pause_s=0.02):
        """Press and release a key of a letter or a name."""
        code = self._x.XKeysymToKeycode(self._display, SYMBOLS.get(key, ord(key[0])))
        for _ in range(times):
            self._send(KEY_PRESS, code)
            self._send(KEY_RELEASE, code)
            time.sleep(pause_s)

    def wheel(self, notches, pause_s=0.02):
        """Turn the wheel: forwards, or backwards where negative."""
        for _ in range(abs(notches)):
            self._send(BUTTON_PRESS, 4 if notches > 0 else 5)
            self._send(BUTTON_RELEASE, 4 if notches > 0 else 5)
            time.sleep(pause_s)

    def leave(self):
        """Go away from the display."""
        self._x.XCloseDisplay(self._display)

    def _send(self, kind, code):
        window, (x, y) = self._under()
        event = KeyEvent(kind, 0, 1, self._display, window, self._root, 0, 0, x, y, x, y, 0, code, 1)
        masks = {KEY_PRESS: 1, KEY_RELEASE: 2, BUTTON_PRESS: 4, BUTTON_RELEASE: 8}
        self._x.XSendEvent(self._display, window, 1, masks[kind], ctypes.byref(event))
        self._x.XFlush(self._display)

    def _under(self):
        """The window under the pointer, and where the pointer is."""
        root, child, mask = ctypes.c_ulong(), ctypes.c_ulong(), ctypes.c_uint()
        x, y, inside_x, inside_y = (ctypes.c_int() for _ in range(4))
        refs = [ctypes.byref(each) for each in (root, child, x, y, inside_x, inside_y, mask)]
        self._x.XQueryPointer(self._display, self._root, *refs)
        return child.value or self._root, (x.value, y.value)
