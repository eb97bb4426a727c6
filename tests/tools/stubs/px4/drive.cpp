/* PX4 around the module, rows as for Betaflight. Three gyro samples in a control step, their times unsteady by a tenth. */
#include "px4.hpp"

#define ORB_DEFINE(name) const orb_metadata orb_##name{sizeof(name##_s), 0, {}}
ORB_DEFINE(vehicle_angular_velocity);
ORB_DEFINE(vehicle_control_mode);
ORB_DEFINE(vehicle_land_detected);
ORB_DEFINE(vehicle_rates_setpoint);
ORB_DEFINE(vehicle_thrust_setpoint);
ORB_DEFINE(vehicle_torque_setpoint);

px4::WorkItem *uORB::SubscriptionCallbackWorkItem::called = nullptr;

static hrt_abstime now = 1000000;

hrt_abstime hrt_absolute_time()
{
	return now;
}

extern "C" int ours_main(int argc, char *argv[]);

int main(int argc, char *argv[])
{
	unsigned step_us;
	if (argc != 2 || std::sscanf(argv[1], "%u", &step_us) != 1) {
		return 1;
	}
	char name[] = "ours", start[] = "start", stop[] = "stop", wrong[] = "wrong";
	char *starts[] = {name, start}, *stops[] = {name, stop}, *wrongs[] = {name, wrong};
	if (ours_main(2, stops) != PX4_OK || ours_main(2, starts) != PX4_OK || ours_main(2, starts) == PX4_OK
	    || ours_main(2, wrongs) == PX4_OK) {
		return 2;
	}
	uORB::Publication<vehicle_angular_velocity_s> gyro{ORB_ID(vehicle_angular_velocity)};
	uORB::Publication<vehicle_control_mode_s> mode{ORB_ID(vehicle_control_mode)};
	uORB::Publication<vehicle_land_detected_s> land{ORB_ID(vehicle_land_detected)};
	uORB::Publication<vehicle_rates_setpoint_s> setpoint{ORB_ID(vehicle_rates_setpoint)};
	uORB::Subscription torques{ORB_ID(vehicle_torque_setpoint)}, thrusts{ORB_ID(vehicle_thrust_setpoint)};
	float a[3], r[3], engines;
	int flies;
	unsigned row = 0;
	const hrt_abstime begin = now;
	while (std::scanf("%f %f %f %f %f %f %f %d", &a[0], &a[1], &a[2], &r[0], &r[1], &r[2], &engines, &flies) == 8) {
		for (unsigned part = 0; part < 3; part++) {
			const unsigned count = 3 * row + part;
			now = begin + uint64_t(count) * step_us / 3 + (count % 2 ? step_us / 30 : 0);
			const bool heard = part == 0;
			// on the ground and disarmed by turns
			mode.publish({now, flies || row % 2, true});
			land.publish({now, !flies});
			setpoint.publish({now, heard ? a[0] : 1.f, heard ? a[1] : 1.f, heard ? a[2] : 1.f, {0.f, 0.f, -engines}, false});
			gyro.publish({now, now, {heard ? r[0] : -1.f, heard ? r[1] : -1.f, heard ? r[2] : -1.f}, {0.f, 0.f, 0.f}});
			uORB::SubscriptionCallbackWorkItem::called->ScheduleNow();
			vehicle_torque_setpoint_s torque;
			vehicle_thrust_setpoint_s thrust;
			const bool told = torques.update(&torque);
			if (told != heard || thrusts.update(&thrust) != heard) {
				std::fprintf(stderr, "row %u, sample %u: published %d\n", row, part, told);
				return 3;
			}
			if (told) {
				if (torque.timestamp_sample != now || thrust.timestamp_sample != now || std::fabs(thrust.xyz[2] + engines) > 0.f) {
					return 4;
				}
				std::printf("%.9g %.9g %.9g\n", double(torque.xyz[0]), double(torque.xyz[1]), double(torque.xyz[2]));
			}
		}
		row++;
	}
	// without rate control nothing is published
	mode.publish({now, true, false});
	gyro.publish({now + step_us, now + step_us, {0.f, 0.f, 0.f}, {0.f, 0.f, 0.f}});
	uORB::SubscriptionCallbackWorkItem::called->ScheduleNow();
	vehicle_torque_setpoint_s torque;
	if (torques.update(&torque)) {
		return 5;
	}
	ours_main(2, stops);
	uORB::SubscriptionCallbackWorkItem::called->ScheduleNow();
	if (uORB::SubscriptionCallbackWorkItem::called != nullptr) {
		return 6;
	}
	// after its end it starts again
	return ours_main(2, starts) == PX4_OK && uORB::SubscriptionCallbackWorkItem::called != nullptr ? 0 : 7;
}
