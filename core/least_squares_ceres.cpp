// The wall around Ceres: builds its problem from ours and runs it. Everything else is in least_squares.c.
#include "core/least_squares_internal.h"

#include <algorithm>
#include <cstring>
#include <exception>
#include <memory>
#include <vector>

#include <ceres/ceres.h>
#include <glog/logging.h>

#include "core/pose.h"

namespace {

// Jacobians come by the tangent already, so the "ambient" Jacobian that Ceres is given carries the tangent's
// columns first and zeros behind, and this manifold's derivative of plus merely picks the free ones.
class TangentManifold final : public ceres::Manifold {
  public:
    explicit TangentManifold(const td_block &block) : block_(block)
    {
        for (int i = 0; i < block.tangent; i++)
            if (td_block_component_free(&block, i)) free_.push_back(i);
    }
    int AmbientSize() const override { return block_.size; }
    int TangentSize() const override { return static_cast<int>(free_.size()); }

    bool Plus(const double *x, const double *delta, double *x_plus_delta) const override
    {
        double full[TD_MAX_BLOCK_SIZE] = {};
        for (size_t i = 0; i < free_.size(); i++) full[free_[i]] = delta[i];
        if (block_.manifold == TD_POSE) {
            td_pose pose, moved;
            std::memcpy(&pose, x, sizeof pose);
            moved = td_pose_perturb(&pose, full);
            std::memcpy(x_plus_delta, &moved, sizeof moved);
        } else {
            for (int i = 0; i < block_.size; i++) x_plus_delta[i] = x[i] + full[i];
        }
        return true;
    }
    bool PlusJacobian(const double *, double *jacobian) const override
    {
        std::memset(jacobian, 0, sizeof(double) * block_.size * free_.size());
        for (size_t i = 0; i < free_.size(); i++) jacobian[free_[i] * free_.size() + i] = 1;
        return true;
    }
    // Ceres' trust region solvers do not ask for these two.
    bool Minus(const double *, const double *, double *) const override { return false; }
    bool MinusJacobian(const double *, double *) const override { return false; }

  private:
    td_block block_;
    std::vector<int> free_;
};

class Residual final : public ceres::CostFunction {
  public:
    Residual(const td_problem &problem, const td_residual &residual) : problem_(problem), residual_(residual)
    {
        set_num_residuals(residual.rows);
        for (int i = 0; i < residual.block_count; i++)
            mutable_parameter_block_sizes()->push_back(problem.block[residual.block[i]].size);
    }
    bool Evaluate(double const *const *value, double *out, double **jacobian) const override
    {
        if (!jacobian) return td_residual_evaluate(&problem_, &residual_, out, nullptr, value);
        double *tangent[TD_MAX_RESIDUAL_BLOCKS];
        std::vector<double> poses[TD_MAX_RESIDUAL_BLOCKS];
        for (int i = 0; i < residual_.block_count; i++) {
            tangent[i] = jacobian[i];
            if (jacobian[i] && problem_.block[residual_.block[i]].manifold == TD_POSE) {
                poses[i].resize(6 * static_cast<size_t>(residual_.rows));
                tangent[i] = poses[i].data();
            }
        }
        if (!td_residual_evaluate(&problem_, &residual_, out, tangent, value)) return false;
        for (int i = 0; i < residual_.block_count; i++)
            for (size_t row = 0; row < poses[i].size() / 6; row++) {
                std::memcpy(jacobian[i] + 7 * row, tangent[i] + 6 * row, 6 * sizeof(double));
                jacobian[i][7 * row + 6] = 0;
            }
        return true;
    }

  private:
    const td_problem &problem_;
    const td_residual &residual_;
};

class Progress final : public ceres::IterationCallback {
  public:
    Progress(const td_progress *progress, int limit) : progress_(progress), limit_(limit) {}
    ceres::CallbackReturnType operator()(const ceres::IterationSummary &iteration) override
    {
        return td_progress_report(progress_, "refining", iteration.iteration, limit_) ? ceres::SOLVER_CONTINUE
                                                                                      : ceres::SOLVER_ABORT;
    }

  private:
    const td_progress *progress_;
    int limit_;
};

bool all_held(const td_problem &problem, const td_residual &residual)
{
    for (int i = 0; i < residual.block_count; i++)
        if (!problem.block[residual.block[i]].held) return false;
    return true;
}

td_status solve(td_problem &problem, td_solve_summary &summary, const td_solve_options &options,
                td_error *error)
{
    // Ceres speaks through its summary, not on stderr. Once: other threads solve, too.
    [[maybe_unused]] static const int quiet = FLAGS_minloglevel = google::GLOG_FATAL;
    // Ceres orders blocks by their address: copies in the order of the blocks make its sums, and so the last
    // bits of the result, the same wherever the caller's values lie.
    std::vector<double> store;
    std::vector<size_t> first;
    for (size_t i = 0; i < problem.block_count; i++) {
        first.push_back(store.size());
        store.insert(store.end(), problem.block[i].value, problem.block[i].value + problem.block[i].size);
    }
    ceres::Problem ceres_problem;
    auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    size_t shared = 0, locals = 0;
    for (size_t i = 0; i < problem.block_count; i++) {
        const td_block &block = problem.block[i];
        double *value = store.data() + first[i];
        ceres_problem.AddParameterBlock(value, block.size);
        if (block.held) {
            ceres_problem.SetParameterBlockConstant(value);
            continue;
        }
        if (block.manifold == TD_POSE || block.held_components)
            ceres_problem.SetManifold(value, new TangentManifold(block));
        ordering->AddElementToGroup(value, block.local ? 0 : 1);
        for (int k = 0; k < block.tangent; k++) summary.parameters += td_block_component_free(&block, k);
        (block.local ? locals : shared)++;
    }
    for (size_t i = 0; i < problem.residual_count; i++) {
        const td_residual &residual = problem.residual[i];
        summary.residuals += residual.rows;
        if (all_held(problem, residual)) continue;
        std::vector<double *> values;
        for (int k = 0; k < residual.block_count; k++)
            values.push_back(store.data() + first[residual.block[k]]);
        ceres_problem.AddResidualBlock(new Residual(problem, residual), nullptr, values);
    }

    ceres::Solver::Options ceres_options;
    ceres_options.linear_solver_type = locals == 0   ? ceres::DENSE_QR
                                       : shared == 0 ? ceres::SPARSE_NORMAL_CHOLESKY
                                                     : ceres::DENSE_SCHUR;
    if (locals && shared) ceres_options.linear_solver_ordering = ordering;
    ceres_options.max_num_iterations = options.max_iterations;
    ceres_options.function_tolerance = options.function_tolerance;
    ceres_options.parameter_tolerance = options.parameter_tolerance;
    ceres_options.gradient_tolerance = options.gradient_tolerance;
    ceres_options.num_threads = options.threads;
    ceres_options.logging_type = ceres::SILENT;
    Progress progress(options.progress, options.max_iterations);
    if (options.progress) ceres_options.callbacks.push_back(&progress);

    ceres::Solver::Summary report;
    ceres::Solve(ceres_options, &ceres_problem, &report);
    for (size_t i = 0; i < problem.block_count; i++)
        std::copy_n(store.data() + first[i], problem.block[i].size, problem.block[i].value);
    summary.converged = report.termination_type == ceres::CONVERGENCE;
    summary.iterations = static_cast<int>(report.iterations.size());
    summary.initial_cost = report.initial_cost;
    summary.final_cost = report.final_cost;
    std::strncpy(summary.message, report.message.c_str(), sizeof summary.message - 1);
    td_log_write(options.log, TD_LOG_DEBUG, "least_squares", "%s", report.BriefReport().c_str());
    if (report.termination_type == ceres::USER_FAILURE)
        return td_fail(error, TD_ERROR_CANCELLED, "interrupted while refining");
    if (!report.IsSolutionUsable())
        return td_fail(error, TD_ERROR_CONVERGENCE, "least squares failed: %s", report.message.c_str());
    return TD_OK;
}

} // namespace

extern "C" td_status td_ceres_solve(td_problem *problem, td_solve_summary *summary,
                                    const td_solve_options *options, td_error *error)
try {
    return solve(*problem, *summary, *options, error);
} catch (const std::bad_alloc &) {
    return td_fail(error, TD_ERROR_MEMORY, "no memory for a least-squares problem of %zu residuals",
                   problem->residual_count);
} catch (const std::exception &e) {
    return td_fail(error, TD_ERROR_EXTERNAL, "Ceres: %s", e.what());
} catch (...) {
    return td_fail(error, TD_ERROR_EXTERNAL, "Ceres: unknown exception");
}
