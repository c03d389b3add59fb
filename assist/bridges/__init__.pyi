from .mqtt import MqttBridge as MqttBridge
from .mqtt_settings import MqttSettings as MqttSettings
from .opcua import OpcUaBridge as OpcUaBridge
from .opcua_server import OpcUaServer as OpcUaServer
from .opcua_settings import OpcUaSettings as OpcUaSettings
from .opcua_settings import OwnServerSettings as OwnServerSettings
from .ros2 import Ros2Bridge as Ros2Bridge
from .ros2_settings import Ros2Settings as Ros2Settings
