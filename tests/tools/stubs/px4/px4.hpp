/* Of PX4 (1.15 and later) what a rate controller's module uses: declarations, and topics that a test reads and writes. */
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>

#define __EXPORT __attribute__((visibility("default")))
#define PX4_OK 0
#define PX4_ERROR (-1)
#define PX4_ISFINITE(x) std::isfinite(x)
#define PX4_ERR(...) std::fprintf(stderr, __VA_ARGS__)
#define PX4_INFO(...) std::fprintf(stderr, __VA_ARGS__)

typedef uint64_t hrt_abstime;
hrt_abstime hrt_absolute_time();

struct vehicle_angular_velocity_s { uint64_t timestamp, timestamp_sample; float xyz[3], xyz_derivative[3]; };
struct vehicle_control_mode_s { uint64_t timestamp; bool flag_armed, flag_control_rates_enabled; };
struct vehicle_land_detected_s { uint64_t timestamp; bool landed; };
struct vehicle_rates_setpoint_s { uint64_t timestamp; float roll, pitch, yaw, thrust_body[3]; bool reset_integral; };
struct vehicle_thrust_setpoint_s { uint64_t timestamp, timestamp_sample; float xyz[3]; };
struct vehicle_torque_setpoint_s { uint64_t timestamp, timestamp_sample; float xyz[3]; };

struct orb_metadata { size_t size; mutable unsigned generation; mutable unsigned char data[128]; };
#define ORB_DECLARE(name) extern const orb_metadata orb_##name
#define ORB_ID(name) (&orb_##name)
ORB_DECLARE(vehicle_angular_velocity);
ORB_DECLARE(vehicle_control_mode);
ORB_DECLARE(vehicle_land_detected);
ORB_DECLARE(vehicle_rates_setpoint);
ORB_DECLARE(vehicle_thrust_setpoint);
ORB_DECLARE(vehicle_torque_setpoint);

namespace px4 {
struct wq_config_t { const char *name; };
namespace wq_configurations {
static constexpr wq_config_t rate_ctrl{"wq:rate_ctrl"};
}
class WorkItem {
public:
	WorkItem(const char *, const wq_config_t &) {}
	virtual ~WorkItem() = default;
	void ScheduleNow() { Run(); }
protected:
	virtual void Run() = 0;
};
template<typename T> class atomic {
public:
	constexpr atomic(T value) : _value(value) {}
	T load() const { return _value; }
	void store(T value) { _value = value; }
private:
	T _value;
};
using atomic_bool = atomic<bool>;
}

namespace uORB {
class Subscription {
public:
	Subscription(const orb_metadata *meta, uint8_t = 0) : _meta(meta) {}
	bool update(void *to)
	{
		if (_seen == _meta->generation) { return false; }
		_seen = _meta->generation;
		std::memcpy(to, _meta->data, _meta->size);
		return true;
	}
private:
	const orb_metadata *_meta;
	unsigned _seen{0};
};
class SubscriptionCallbackWorkItem : public Subscription {
public:
	SubscriptionCallbackWorkItem(px4::WorkItem *item, const orb_metadata *meta) : Subscription(meta), _item(item) {}
	bool registerCallback() { called = _item; return true; }
	void unregisterCallback() { called = nullptr; }
	static px4::WorkItem *called;
private:
	px4::WorkItem *_item;
};
template<typename T> class Publication {
public:
	Publication(const orb_metadata *meta) : _meta(meta) {}
	bool publish(const T &data)
	{
		std::memcpy(_meta->data, &data, sizeof(data));
		_meta->generation++;
		return true;
	}
private:
	const orb_metadata *_meta;
};
}
