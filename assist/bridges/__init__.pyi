from .mqtt import MqttBridge as MqttBridge
from .mqtt_settings import MqttSettings as MqttSettings
from .opcua import OpcUaBridge as OpcUaBridge
from .opcua_settings import OpcUaSettings as OpcUaSettings
