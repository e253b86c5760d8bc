"""The physics, without images: constraints, Lagrangian and Hamiltonian mechanics, integrators, energies."""

from keycld.mechanics.adaptive import AdaptiveDynamics as AdaptiveDynamics
from keycld.mechanics.adaptive import DormandPrince as DormandPrince
from keycld.mechanics.adaptive import adaptive_rollout as adaptive_rollout
from keycld.mechanics.circle import nearest_circle as nearest_circle
from keycld.mechanics.constants import Scale as Scale
from keycld.mechanics.constants import lengths_of as lengths_of
from keycld.mechanics.constants import physical_constants as physical_constants
from keycld.mechanics.constraints import AbstractConstraint as AbstractConstraint
from keycld.mechanics.constraints import Constraints as Constraints
from keycld.mechanics.constraints import FunctionConstraint as FunctionConstraint
from keycld.mechanics.constraints import as_constraint as as_constraint
from keycld.mechanics.constraints_toml import dump_constraints as dump_constraints
from keycld.mechanics.constraints_toml import load_constraints as load_constraints
from keycld.mechanics.constraints_toml import mechanisms as mechanisms
from keycld.mechanics.constraints_toml import parse_constraints as parse_constraints
from keycld.mechanics.dense import Linear as Linear
from keycld.mechanics.dense import SwishEnergy as SwishEnergy
from keycld.mechanics.dense import SwishMLP as SwishMLP
from keycld.mechanics.dense import begin_as_identity as begin_as_identity
from keycld.mechanics.dense import lecun_normal as lecun_normal
from keycld.mechanics.dense import truncated_normal as truncated_normal
from keycld.mechanics.discovery import Candidate as Candidate
from keycld.mechanics.discovery import candidates as candidates
from keycld.mechanics.dynamics import AbstractMechanicalDynamics as AbstractMechanicalDynamics
from keycld.mechanics.dynamics import MechanicalDynamics as MechanicalDynamics
from keycld.mechanics.dynamics import joining_velocity as joining_velocity
from keycld.mechanics.estimate import Derived as Derived
from keycld.mechanics.estimate import Estimate as Estimate
from keycld.mechanics.estimate import derive as derive
from keycld.mechanics.estimate import estimate as estimate
from keycld.mechanics.fan import Fan as Fan
from keycld.mechanics.fan import predict_fan as predict_fan
from keycld.mechanics.fitting import Fitted as Fitted
from keycld.mechanics.fitting import fit_motions as fit_motions
from keycld.mechanics.fitting import rough_states as rough_states
from keycld.mechanics.force import AbstractDissipationTerm as AbstractDissipationTerm
from keycld.mechanics.force import AbstractPotentialTerm as AbstractPotentialTerm
from keycld.mechanics.force import AbstractTerm as AbstractTerm
from keycld.mechanics.force import SumDissipation as SumDissipation
from keycld.mechanics.force import SumPotential as SumPotential
from keycld.mechanics.force import register_term as register_term
from keycld.mechanics.force import term_kinds as term_kinds
from keycld.mechanics.force import terms_of as terms_of
from keycld.mechanics.force import with_kinds as with_kinds
from keycld.mechanics.force import with_terms as with_terms
from keycld.mechanics.forces.perceptron import PerceptronPotential as PerceptronPotential
from keycld.mechanics.forces.springs import Springs as Springs
from keycld.mechanics.forces.viscous import ViscousFriction as ViscousFriction
from keycld.mechanics.generalized import GeneralizedLagrangian as GeneralizedLagrangian
from keycld.mechanics.generalized import MLPFactor as MLPFactor
from keycld.mechanics.generalized import pulled_back as pulled_back
from keycld.mechanics.hamiltonian import AbstractHamiltonian as AbstractHamiltonian
from keycld.mechanics.hamiltonian import Hamiltonian as Hamiltonian
from keycld.mechanics.hamiltonian import LegendreLaw as LegendreLaw
from keycld.mechanics.hamiltonian import SeparableHamiltonian as SeparableHamiltonian
from keycld.mechanics.hamiltonian import momentum as momentum
from keycld.mechanics.hamiltonian import to_hamiltonian as to_hamiltonian
from keycld.mechanics.integrators import RK2 as RK2
from keycld.mechanics.integrators import RK4 as RK4
from keycld.mechanics.integrators import AbstractIntegrator as AbstractIntegrator
from keycld.mechanics.integrators import Euler as Euler
from keycld.mechanics.integrators import Leapfrog as Leapfrog
from keycld.mechanics.joint_balance import FittedJointLaw as FittedJointLaw
from keycld.mechanics.joint_balance import JointLaw as JointLaw
from keycld.mechanics.joint_balance import fit_joint_law as fit_joint_law
from keycld.mechanics.joint_balance import predict_joints as predict_joints
from keycld.mechanics.joint_coordinates import Joint as Joint
from keycld.mechanics.joint_coordinates import joint_positions as joint_positions
from keycld.mechanics.joint_coordinates import joints_of as joints_of
from keycld.mechanics.lagrangian import AbstractLagrangian as AbstractLagrangian
from keycld.mechanics.lagrangian import AbstractLaw as AbstractLaw
from keycld.mechanics.lagrangian import ConstrainedLagrangian as ConstrainedLagrangian
from keycld.mechanics.linear import matmul as matmul
from keycld.mechanics.linear import solve_definite as solve_definite
from keycld.mechanics.linear import solve_positive as solve_positive
from keycld.mechanics.masses import AbstractMassMatrix as AbstractMassMatrix
from keycld.mechanics.masses import CoupledMasses as CoupledMasses
from keycld.mechanics.masses import PointMasses as PointMasses
from keycld.mechanics.mjcf import to_mjcf as to_mjcf
from keycld.mechanics.named import integrator_named as integrator_named
from keycld.mechanics.networks import AffineMLPInputMatrix as AffineMLPInputMatrix
from keycld.mechanics.networks import MLPInputMatrix as MLPInputMatrix
from keycld.mechanics.networks import MLPPotential as MLPPotential
from keycld.mechanics.networks import Perceptron as Perceptron
from keycld.mechanics.own_parameters import Own as Own
from keycld.mechanics.own_parameters import moved as moved
from keycld.mechanics.own_parameters import own_law as own_law
from keycld.mechanics.own_parameters import own_parameters as own_parameters
from keycld.mechanics.own_parameters import rough_places as rough_places
from keycld.mechanics.phase_space import FirstOrderDynamics as FirstOrderDynamics
from keycld.mechanics.phase_space import HamiltonianDynamics as HamiltonianDynamics
from keycld.mechanics.rattle import Rattle as Rattle
from keycld.mechanics.regression import regress_forces as regress_forces
from keycld.mechanics.relation import AbstractDisplacement as AbstractDisplacement
from keycld.mechanics.relation import AbstractRelation as AbstractRelation
from keycld.mechanics.relation import register_relation as register_relation
from keycld.mechanics.relations.distance_to_point import DistanceToPoint as DistanceToPoint
from keycld.mechanics.relations.fixed_distance import FixedDistance as FixedDistance
from keycld.mechanics.relations.on_line import OnLine as OnLine
from keycld.mechanics.rest_pose import RestPose as RestPose
from keycld.mechanics.rest_pose import rest_pose as rest_pose
from keycld.mechanics.rigid_body import PointPair as PointPair
from keycld.mechanics.rigid_body import RigidBody as RigidBody
from keycld.mechanics.rigid_body import rigid_body as rigid_body
from keycld.mechanics.rigid_body import two_point_masses as two_point_masses
from keycld.mechanics.runge_kutta import RungeKutta as RungeKutta
from keycld.mechanics.second_order import SecondOrderNetwork as SecondOrderNetwork
from keycld.mechanics.shake import Shake as Shake
from keycld.mechanics.singular import is_singular as is_singular
from keycld.mechanics.singular import turns_within as turns_within
from keycld.mechanics.singular import variation as variation
from keycld.mechanics.state import AbstractDynamics as AbstractDynamics
from keycld.mechanics.state import AbstractField as AbstractField
from keycld.mechanics.state import Motion as Motion
from keycld.mechanics.state import PhasePoint as PhasePoint
from keycld.mechanics.state import Scalar as Scalar
from keycld.mechanics.state import State as State
from keycld.mechanics.symplectic import Composition as Composition

__all__ = [
    "AbstractConstraint",
    "AbstractDisplacement",
    "AbstractDissipationTerm",
    "AbstractDynamics",
    "AbstractField",
    "AbstractHamiltonian",
    "AbstractIntegrator",
    "AbstractLagrangian",
    "AbstractLaw",
    "AbstractMassMatrix",
    "AbstractMechanicalDynamics",
    "AbstractPotentialTerm",
    "AbstractRelation",
    "AbstractTerm",
    "AdaptiveDynamics",
    "AffineMLPInputMatrix",
    "Candidate",
    "Composition",
    "ConstrainedLagrangian",
    "Constraints",
    "CoupledMasses",
    "Derived",
    "DistanceToPoint",
    "DormandPrince",
    "Estimate",
    "Euler",
    "Fan",
    "FirstOrderDynamics",
    "Fitted",
    "FixedDistance",
    "FunctionConstraint",
    "GeneralizedLagrangian",
    "Hamiltonian",
    "HamiltonianDynamics",
    "FittedJointLaw",
    "Joint",
    "JointLaw",
    "Leapfrog",
    "LegendreLaw",
    "Linear",
    "MLPFactor",
    "MLPInputMatrix",
    "MLPPotential",
    "MechanicalDynamics",
    "Motion",
    "OnLine",
    "Own",
    "Perceptron",
    "PerceptronPotential",
    "PhasePoint",
    "PointMasses",
    "PointPair",
    "RK2",
    "RK4",
    "Rattle",
    "RestPose",
    "RigidBody",
    "RungeKutta",
    "Scalar",
    "Scale",
    "SecondOrderNetwork",
    "SeparableHamiltonian",
    "Shake",
    "Springs",
    "State",
    "SumDissipation",
    "SumPotential",
    "SwishEnergy",
    "SwishMLP",
    "begin_as_identity",
    "ViscousFriction",
    "adaptive_rollout",
    "as_constraint",
    "candidates",
    "derive",
    "dump_constraints",
    "estimate",
    "fit_joint_law",
    "fit_motions",
    "integrator_named",
    "is_singular",
    "joining_velocity",
    "joint_positions",
    "joints_of",
    "lecun_normal",
    "lengths_of",
    "load_constraints",
    "matmul",
    "mechanisms",
    "momentum",
    "moved",
    "nearest_circle",
    "own_law",
    "own_parameters",
    "parse_constraints",
    "physical_constants",
    "predict_fan",
    "predict_joints",
    "pulled_back",
    "register_relation",
    "register_term",
    "regress_forces",
    "rest_pose",
    "rigid_body",
    "rough_places",
    "rough_states",
    "solve_definite",
    "solve_positive",
    "term_kinds",
    "terms_of",
    "to_hamiltonian",
    "to_mjcf",
    "truncated_normal",
    "turns_within",
    "two_point_masses",
    "variation",
    "with_kinds",
    "with_terms",
]
