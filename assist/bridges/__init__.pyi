from .mqtt import MqttBridge as MqttBridge
from .settings import MqttSettings as MqttSettings
