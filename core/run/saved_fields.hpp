// The fields of all that a world saves, for base/byte_archive.hpp.
//
// Every struct is taken apart by a structured binding, which does not compile once the struct has another number of
// fields: none is forgotten.
#pragma once

#include "base/byte_archive.hpp"
#include "run/saved_world.hpp"

namespace contactvi {

template <class Archive>
void fields(Archive& a, Status& x) {
  auto& [code, message, time, guard, accumulation_time, depth] = x;
  values(a, code, message, time, guard, accumulation_time, depth);
}

template <class Archive>
void fields(Archive& a, StepLength& x) {
  auto& [nominal, longest, solved_in_row] = x;
  values(a, nominal, longest, solved_in_row);
}

template <class Archive>
void fields(Archive& a, StepControl& x) {
  auto& [free, contact, flight, without_progress, halved] = x;
  values(a, free, contact, flight, without_progress, halved);
}

template <class Archive>
void fields(Archive& a, ImpactReference& x) {
  auto& [kind, reference, q, p, t, step] = x;
  values(a, kind, reference, q, p, t, step);
}

template <class Archive>
void fields(Archive& a, Bouncing& x) {
  auto& [last_time, last_flight, longest_flight, last_speed, impacts, shrinking_flights, short_flights] = x;
  values(a, last_time, last_flight, longest_flight, last_speed, impacts, shrinking_flights, short_flights);
}

template <class Archive>
void fields(Archive& a, Flights& x) {
  std::vector<Flights::Entry> entries = x.entries();
  value(a, entries);
  if constexpr (Archive::kReads)
    for (const Flights::Entry& entry : entries) x.at(entry.first) = entry.second;
}

template <class Archive>
void fields(Archive& a, ChangeRecord& x) {
  auto& [time, guard, point, change, number] = x;
  values(a, time, guard, point, change, number);
}

template <class Archive>
void fields(Archive& a, Servo& x) {
  // Moving references are those of one call.
  [[maybe_unused]] auto& [any, kp, kd, q_ref, v_ref, feed, moving, held] = x;
  values(a, any, kp, kd, q_ref, v_ref, feed, held);
}

template <class Archive>
void fields(Archive& a, ActuatorState& x) {
  auto& [given, limited, servo, saturated] = x;
  values(a, given, limited, servo, saturated);
}

template <class Archive>
void fields(Archive& a, SwitchCounts& x) {
  auto& [located, jumps, held] = x;
  values(a, located, jumps, held);
}

template <class Archive>
void fields(Archive& a, EnergyWatch& x) {
  auto& [known, start, scale] = x;
  values(a, known, start, scale);
}

template <class Archive>
void fields(Archive& a, WorkTally& x) {
  auto& [does_work, input, damping, joint_friction, driven, reactions, mean_reactions, node_time, pending] = x;
  values(a, does_work, input, damping, joint_friction, driven, reactions, mean_reactions, node_time, pending);
}

template <class Archive>
void fields(Archive& a, WorkAccount& x) {
  WorkTally tally = x.tally();
  value(a, tally);
  if constexpr (Archive::kReads) x.recall(tally);
}

template <class Archive>
void fields(Archive& a, LocatedCost& x) {
  values(a, x.excess);
}

template <class Archive>
void fields(Archive& a, DensePhase& x) {
  auto& [active, quiet, wanted, since_return, longest, located] = x;
  values(a, active, quiet, wanted, since_return, longest, located);
}

template <class Archive>
void fields(Archive& a, ContactStepsUntil& x) {
  auto& [time, span] = x;
  values(a, time, span);
}

template <class Archive>
void fields(Archive& a, SeparatedPoint& x) {
  auto& [guard, feature, left] = x;
  values(a, guard, feature, left);
}

template <class Archive>
void fields(Archive& a, RunState& x) {
  auto& [start_time, time, step, q, p, status, control, adaptive_dt, reference, flights, largest_speed, separated,
         initial_changes, actuators, switches, watch, work, dense, impacts, rejected, dense_steps, contact_seconds,
         deepest, contact_steps] = x;
  values(a, start_time, time, step, q, p, status, control, adaptive_dt, reference, flights, largest_speed, separated,
         initial_changes, actuators, switches, watch, work, dense, impacts, rejected, dense_steps, contact_seconds,
         deepest, contact_steps);
}

template <class Archive>
void fields(Archive& a, StartValues::History& x) {
  auto& [velocities, lengths] = x;
  values(a, velocities, lengths);
}

template <class Archive>
void fields(Archive& a, Integrator::Memory& x) {
  auto& [start, carry_q, carry_p, momenta, forces, newton] = x;
  values(a, start, carry_q, carry_p, momenta, forces, newton);
}

template <class Archive>
void fields(Archive& a, ContactPoint& x) {
  auto& [guard, kind, feature, material, on_b, point_body, plane_body, center_B, radius, normal_B, offset, axis_B,
         rim_radius, far_B, origin_B] = x;
  values(a, guard, kind, feature, material, on_b, point_body, plane_body, center_B, radius, normal_B, offset, axis_B,
         rim_radius, far_B, origin_B);
}

template <class Archive>
void fields(Archive& a, Contact& x) {
  auto& [gap, normal, point_a, point_b, body_a, body_b] = x;
  values(a, gap, normal, point_a, point_b, body_a, body_b);
}

template <class Archive>
void fields(Archive& a, PersistentContact& x) {
  auto& [point, mu, sticks, heading, slip, anchored, anchor, tangent, force, is_new, pull_share, body_shares,
         by_velocity, spinning, rolling, spin, roll, turning_force] = x;
  values(a, point, mu, sticks, heading, slip, anchored, anchor, tangent, force, is_new, pull_share, body_shares,
         by_velocity, spinning, rolling, spin, roll, turning_force);
}

template <class Archive>
void fields(Archive& a, ContactOutcome& x) {
  auto& [contact, t1, t2, position_impulse_W, velocity_impulse_W, position_impulse, velocity_impulse, slip_W,
         friction_work, w_n, slipped, slips, turned, reversed, active, keeps, freed, slip, paradox, jumps,
         position_turning, velocity_turning, spin, roll_W, rolled, rolls, roll_turned, roll_keeps, roll_freed,
         turning_slip, roll_reversed] = x;
  values(a, contact, t1, t2, position_impulse_W, velocity_impulse_W, position_impulse, velocity_impulse, slip_W,
         friction_work, w_n, slipped, slips, turned, reversed, active, keeps, freed, slip, paradox, jumps,
         position_turning, velocity_turning, spin, roll_W, rolled, rolls, roll_turned, roll_keeps, roll_freed,
         turning_slip, roll_reversed);
}

template <class Archive>
void fields(Archive& a, ContactStep::Node& x) {
  auto& [known, t, motions, q, phi, rate, at, t1, side, along, W] = x;  // motions follow from t
  values(a, known, t, q, phi, rate, at, t1, side, along, W);
}

template <class Archive>
void fields(Archive& a, FrictionJoint& x) {
  auto& [dof, iq, limit, anchored, anchor, reference, speed, sticks, heading] = x;
  values(a, dof, iq, limit, anchored, anchor, reference, speed, sticks, heading);
}

template <class Archive>
void fields(Archive& a, Extrapolation::History& x) {
  auto& [count, degree, lengths, differences] = x;
  values(a, count, degree, lengths, differences);
}

template <class Archive>
void fields(Archive& a, ContactStep::Memory& x) {
  auto& [contacts, outcomes, node, reference_positions, friction_joints, fixed_force, v_node, v1, shift, velocities,
         row_forces, p1, contraction, nominal_h, follows, modes_known] = x;
  values(a, contacts, outcomes, node, reference_positions, friction_joints, fixed_force, v_node, v1, shift, velocities,
         row_forces, p1, contraction, nominal_h, follows, modes_known);
}

template <class Archive>
void fields(Archive& a, DenseImpulse& x) {
  auto& [guard, feature, position_force, velocity_force, position_turning, velocity_turning] = x;
  values(a, guard, feature, position_force, velocity_force, position_turning, velocity_turning);
}

template <class Archive>
void fields(Archive& a, DenseStep::Memory& x) {
  auto& [impulses, joint_friction, closed, change, h] = x;
  values(a, impulses, joint_friction, closed, change, h);
}

template <class Archive>
void fields(Archive& a, EventFinder::Memory& x) {
  auto& [touching, exempt, rate, q, p, h] = x;
  values(a, touching, exempt, rate, q, p, h);
}

template <class Archive>
void fields(Archive& a, Box& x) {
  auto& [center, half] = x;
  values(a, center, half);
}

template <class Archive>
void fields(Archive& a, BroadPhase::NearPair& x) {
  auto& [guard, first, second] = x;
  values(a, guard, first, second);
}

template <class Archive>
void fields(Archive& a, BroadPhase::Memory& x) {
  auto& [boxes, limits, near] = x;
  values(a, boxes, limits, near);
}

template <class Archive>
void fields(Archive& a, Guards::Memory& x) {
  auto& [odometer, marks, broad_phase] = x;
  values(a, odometer, marks, broad_phase);
}

template <class Archive>
void fields(Archive& a, EngineMemory& x) {
  auto& [integrator, contact_step, dense_step, finder, guards, searched_contact_step] = x;
  values(a, integrator, contact_step, dense_step, finder, guards, searched_contact_step);
}

template <class Archive>
void fields(Archive& a, StepCounters& x) {
  auto& [steps, stage_iterations, factorizations] = x;
  values(a, steps, stage_iterations, factorizations);
}

template <class Archive>
void fields(Archive& a, GuardCounters& x) {
  auto& [evaluated, skipped, distances, cost] = x;
  values(a, evaluated, skipped, distances, cost);
}

template <class Archive>
void fields(Archive& a, ContactStepCounters& x) {
  auto& [steps, contact_iterations, problems, iterations, fallbacks, cost] = x;
  values(a, steps, contact_iterations, problems, iterations, fallbacks, cost);
}

template <class Archive>
void fields(Archive& a, DenseStepCounters& x) {
  auto& [problems, sweeps, factorizations, gap_iterations, passes] = x;
  values(a, problems, sweeps, factorizations, gap_iterations, passes);
}

template <class Archive>
void fields(Archive& a, EngineCounters& x) {
  auto& [steps, guards, contact, dense] = x;
  values(a, steps, guards, contact, dense);
}

template <class Archive>
void fields(Archive& a, Snapshot& x) {
  auto& [run, memory, counters] = x;
  values(a, run, memory, counters);
}

template <class Archive>
void fields(Archive& a, LooseState& x) {
  auto& [control, largest_speed, contact_steps, contacts, touching, exempt, separated, flights, dense, impulses, closed,
         change, change_h] = x;
  values(a, control, largest_speed, contact_steps, contacts, touching, exempt, separated, flights, dense, impulses,
         closed, change, change_h);
}

template <class Archive>
void fields(Archive& a, JointFriction& x) {
  auto& [anchored, anchor, force] = x;
  values(a, anchored, anchor, force);
}

template <class Archive>
void fields(Archive& a, Rest& x) {
  auto& [steps, q] = x;
  values(a, steps, q);
}

template <class Archive>
void fields(Archive& a, ImpactRecord& x) {
  auto& [time, guard, point, normal, impulse_vector, impulse, gamma_minus, gamma_plus, G_c, gap, restitution, friction,
         points, loss, method, iterations, fallback, jump, before, after, step, q, p_minus, p_plus] = x;
  values(a, time, guard, point, normal, impulse_vector, impulse, gamma_minus, gamma_plus, G_c, gap, restitution,
         friction, points, loss, method, iterations, fallback, jump, before, after, step, q, p_minus, p_plus);
}

template <class Archive>
void fields(Archive& a, Segments& x) {
  auto& [t, h, q, p, p1, rates, persistent] = x;
  values(a, t, h, q, p, p1, rates, persistent);
}

template <class Archive>
void fields(Archive& a, ContactRow& x) {
  auto& [t, h, guard, point, mode, step, position, normal, position_impulse, velocity_impulse, gap, slip, work, dense] =
      x;
  values(a, t, h, guard, point, mode, step, position, normal, position_impulse, velocity_impulse, gap, slip, work,
         dense);
}

template <class Archive>
void fields(Archive& a, DenseRecord& x) {
  auto& [time, h, residual, gap, energy_rise, energy_loss, energy_error, contacts, repaired, step, island] = x;
  values(a, time, h, residual, gap, energy_rise, energy_loss, energy_error, contacts, repaired, step, island);
}

template <class Archive>
void fields(Archive& a, Recording& x) {
  // What is saved is the record of one island, and what lies still is told of a world.
  auto& [t, q, p, work, reactions, impacts, segments, adaptive_t, adaptive_dt, contacts, still, changes, dense, phase_t,
         phase_dt, phase_kind] = x;
  values(a, t, q, p, work, reactions, impacts, segments, adaptive_t, adaptive_dt, contacts, changes, dense, phase_t,
         phase_dt, phase_kind);
}

template <class Archive>
void fields(Archive& a, SavedWorld::SavedIsland& x) {
  auto& [trees, engine, rest, record, mean_reactions, tau, target, turns] = x;
  values(a, trees, engine, rest, record, mean_reactions, tau, target, turns);
}

template <class Archive>
void fields(Archive& a, SavedWorld& x) {
  auto& [whole, divided, run, loose, joint_friction, motion, straight, tau, q_ref, v_ref, counters, islands] = x;
  values(a, whole, divided, run, loose, joint_friction, motion, straight, tau, q_ref, v_ref, counters, islands);
}

}  // namespace contactvi
