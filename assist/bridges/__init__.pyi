from .mqtt import MqttBridge as MqttBridge
from .opcua import OpcUaBridge as OpcUaBridge
from .opcua_settings import OpcUaSettings as OpcUaSettings
from .settings import MqttSettings as MqttSettings
