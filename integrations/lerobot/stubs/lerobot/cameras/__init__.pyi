class CameraConfig:
    height: int | None
    width: int | None

class Camera:
    height: int | None
    width: int | None
    @property
    def is_connected(self) -> bool: ...
    def connect(self, warmup: bool = ...) -> None: ...
    def disconnect(self) -> None: ...
