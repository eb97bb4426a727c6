[[ licence ]]
/* [[ title ]] in PX4: a module in the place of mc_rate_control.
 *
 * PX4's axes are the controller's: forward, right, down, in rad/s. The controller runs at the gyro samples that are nearest to
 * every [[ step ]] s; torque and thrust are published then.
 */
#include <drivers/drv_hrt.h>
#include <px4_platform_common/atomic.h>
#include <px4_platform_common/defines.h>
#include <px4_platform_common/log.h>
#include <px4_platform_common/px4_work_queue/WorkItem.hpp>
#include <uORB/Publication.hpp>
#include <uORB/Subscription.hpp>
#include <uORB/SubscriptionCallback.hpp>
#include <uORB/topics/vehicle_angular_velocity.h>
#include <uORB/topics/vehicle_control_mode.h>
#include <uORB/topics/vehicle_land_detected.h>
#include <uORB/topics/vehicle_rates_setpoint.h>
#include <uORB/topics/vehicle_thrust_setpoint.h>
#include <uORB/topics/vehicle_torque_setpoint.h>

#include <cstring>

#include "[[ n ]]_rates.h"

/* Its start, stop and status are its own: PX4's ModuleBase is a template up to 1.17 and none after it. */
class [[ Class ]] : public px4::WorkItem
{
public:
	[[ Class ]]();
	~[[ Class ]]() override = default;

	bool init();
	void stop() { _stops.store(true); }

private:
	static constexpr hrt_abstime STEP_US = [[ step_us ]];

	void Run() override;
	bool due(hrt_abstime now);

	uORB::SubscriptionCallbackWorkItem _angular_velocity_sub{this, ORB_ID(vehicle_angular_velocity)};
	uORB::Subscription _control_mode_sub{ORB_ID(vehicle_control_mode)};
	uORB::Subscription _land_detected_sub{ORB_ID(vehicle_land_detected)};
	uORB::Subscription _rates_setpoint_sub{ORB_ID(vehicle_rates_setpoint)};
	uORB::Publication<vehicle_thrust_setpoint_s> _thrust_setpoint_pub{ORB_ID(vehicle_thrust_setpoint)};
	uORB::Publication<vehicle_torque_setpoint_s> _torque_setpoint_pub{ORB_ID(vehicle_torque_setpoint)};

	vehicle_control_mode_s _control_mode{};
	vehicle_land_detected_s _land_detected{};
	vehicle_rates_setpoint_s _rates_setpoint{};

	[[ n ]]_Rates _rates{};
	px4::atomic_bool _stops{false};
	bool _begun{false};
	hrt_abstime _before{0}; // sample
	hrt_abstime _due{0};
};

static px4::atomic<[[ Class ]] *> running{nullptr};

[[ Class ]]::[[ Class ]]() :
	WorkItem(MODULE_NAME, px4::wq_configurations::rate_ctrl)
{
}

bool [[ Class ]]::init()
{
	if (!_angular_velocity_sub.registerCallback()) {
		PX4_ERR("callback registration failed");
		return false;
	}

	return true;
}

/* Whether this sample is the one nearest to the time of the next step; the first is, and one behind a gap of a step. */
bool [[ Class ]]::due(hrt_abstime now)
{
	if (!_begun) {
		[[ n ]]_rates_reset(&_rates);
		_before = now;
		_due = now;
		_begun = true;
	}

	const hrt_abstime half = (now - _before) / 2;
	_before = now;

	if (now + half < _due) {
		return false;
	}

	_due += STEP_US;

	if (now >= _due) {
		_due = now + STEP_US;
	}

	return true;
}

void [[ Class ]]::Run()
{
	if (_stops.load()) {
		_angular_velocity_sub.unregisterCallback();
		running.store(nullptr);
		delete this; // here, because nothing else of it runs while its queue runs it
		return;
	}

	vehicle_angular_velocity_s angular_velocity;

	if (!_angular_velocity_sub.update(&angular_velocity)) {
		return;
	}

	_control_mode_sub.update(&_control_mode);
	_land_detected_sub.update(&_land_detected);
	_rates_setpoint_sub.update(&_rates_setpoint);

	if (!_control_mode.flag_control_rates_enabled) {
		_begun = false;
		return;
	}

	if (!due(angular_velocity.timestamp_sample)) {
		return;
	}

	const float asked[3] = {_rates_setpoint.roll, _rates_setpoint.pitch, _rates_setpoint.yaw};
	[[ n ]]_Real setpoint[3];
	[[ n ]]_Real measured[3];
	[[ n ]]_Real torque[3];

	for (int i = 0; i < 3; i++) {
		measured[i] = angular_velocity.xyz[i];
		setpoint[i] = PX4_ISFINITE(asked[i]) ? asked[i] : measured[i]; // an axis that is not asked for
	}

	const float upward = PX4_ISFINITE(_rates_setpoint.thrust_body[2]) ? -_rates_setpoint.thrust_body[2] : 0.f;
	const bool flies = _control_mode.flag_armed && !_land_detected.landed;
	[[ n ]]_rates_step(&_rates, setpoint, measured, upward, flies, torque);

	vehicle_thrust_setpoint_s thrust_setpoint{};
	vehicle_torque_setpoint_s torque_setpoint{};

	for (int i = 0; i < 3; i++) {
		thrust_setpoint.xyz[i] = PX4_ISFINITE(_rates_setpoint.thrust_body[i]) ? _rates_setpoint.thrust_body[i] : 0.f;
		torque_setpoint.xyz[i] = torque[i];
	}

	thrust_setpoint.timestamp_sample = angular_velocity.timestamp_sample;
	torque_setpoint.timestamp_sample = angular_velocity.timestamp_sample;
	thrust_setpoint.timestamp = hrt_absolute_time();
	_thrust_setpoint_pub.publish(thrust_setpoint);
	torque_setpoint.timestamp = hrt_absolute_time();
	_torque_setpoint_pub.publish(torque_setpoint);
}

static int start()
{
	if (running.load() != nullptr) {
		PX4_ERR("already running");
		return PX4_ERROR;
	}

	[[ Class ]] *instance = new [[ Class ]]();

	if (instance == nullptr) {
		PX4_ERR("alloc failed");
		return PX4_ERROR;
	}

	running.store(instance);

	if (!instance->init()) {
		running.store(nullptr);
		delete instance;
		return PX4_ERROR;
	}

	return PX4_OK;
}

extern "C" __EXPORT int [[ n ]]_main(int argc, char *argv[])
{
	const char *word = argc > 1 ? argv[1] : "";

	if (std::strcmp(word, "start") == 0) {
		return start();
	}

	[[ Class ]] *instance = running.load();

	if (std::strcmp(word, "stop") == 0 && instance != nullptr) {
		instance->stop(); // at its next gyro sample
		return PX4_OK;
	}

	if (std::strcmp(word, "stop") == 0 || std::strcmp(word, "status") == 0) {
		PX4_INFO("%s", instance != nullptr ? "running" : "not running");
		return PX4_OK;
	}

	PX4_INFO("[[ title ]]: a rate loop in the place of mc_rate_control's; allowed: start, stop, status");
	return PX4_ERROR;
}
