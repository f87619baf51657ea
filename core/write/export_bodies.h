// SPDX-License-Identifier: GPL-3.0-or-later
//
// Spheres -> a rigid body for robots and granular matter, as their programs load it. One .cpp a format. All files are
// in SI units, say so, and say where their frame lies. Mass, centre and inertia are those of the union: what overlaps
// counts once.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/base/geometry.h"
#include "core/measure/union.h"

namespace spherule {

/// A union of balls as a solid of even density, in metres and kilograms. Its frame has the axes of the model's and its
/// origin at `origin_mm` of it: x = (x_model - origin_mm) / 1000.
struct RigidBody {
  Vec3 origin_mm;
  double density_kg_m3 = 0;
  std::vector<Sphere> spheres;         ///< m; each once, without those that add nothing to the union
  std::vector<double> sphere_mass_kg;  ///< of each sphere's part of the union; they add to mass_kg
  double volume_m3 = 0, mass_kg = 0;
  Vec3 centre_m;                                 ///< of mass
  Mat3 inertia_kg_m2{{Vec3{}, Vec3{}, Vec3{}}};  ///< about `centre_m`; off the diagonal are minus the products
};

/// Where a body's frame has its origin.
enum class BodyOrigin : unsigned char {
  frame,   ///< where the model's frame has it
  centre,  ///< at the centre of mass
};

/// `whole` must be the measures of `balls`. Throws unusable for a union without volume.
RigidBody rigid_body(std::span<const Sphere> balls, const UnionMeasures& whole, double density_kg_m3,
                     BodyOrigin origin);

// Robots. `link` names the link whose frame the body's is; a letter or underscore, then letters, digits, underscores.

/// URDF (https://wiki.ros.org/urdf/XML): a robot of one link with its inertial and one <collision> a sphere.
std::string body_to_urdf(const RigidBody& body, const std::string& link);
/// SRDF, to merge into a robot's own: <link_sphere_approximation> of one link, as srdfdom and MoveIt read it.
std::string body_to_srdf(const RigidBody& body, const std::string& link);
/// XRDF 1.0 (https://nvidia-isaac-ros.github.io/concepts/manipulation/xrdf.html), beside the URDF above: collision
/// spheres of one link, and no joints.
std::string body_to_xrdf(const RigidBody& body, const std::string& link);
/// What cuRobo's robot configurations name under `collision_spheres`, YAML.
std::string body_to_curobo(const RigidBody& body, const std::string& link);

// Granular matter.

/// LIGGGHTS: the file of `fix particletemplate/multisphere … spheres file`, one line "x y z r" a sphere; a comment has
/// the whole command with exact mass and inertia.
std::string body_to_liggghts(const RigidBody& body);
/// LAMMPS molecule file (https://docs.lammps.org/molecule.html) with mass, com and inertia, for units si: fix
/// rigid/small, pour and deposit take it. Every sphere is of type 1 and has the mass of its part of the union.
std::string body_to_lammps(const RigidBody& body);
/// YADE: what ymport.textClumps reads (x_y_z_r_clumpId), as one clump of id 0. ymport.text reads it as loose spheres.
std::string body_to_yade(const RigidBody& body);

}  // namespace spherule
