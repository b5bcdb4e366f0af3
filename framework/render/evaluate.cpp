// evaluate: one function over rows of raw numbers.

#include "commands.hpp"
#include "followed.hpp"
#include "traced.hpp"

#include "text/json.hpp"

#include <shadelab/error.hpp>
#include <shadelab/plugin_library.hpp>

#include <fstream>
#include <memory>

namespace shadelab {

namespace {

struct EvaluateOptions {
    std::string plugin, function, input, output, follow, statistics, trace;
    int repeat = 0;
    std::vector<int> bodies;
};

// ---- the table

template <class Real>
void evaluate(const EvaluateOptions& options, const PluginLibrary& library) {
    if (!options.follow.empty()) start_following<Real>(options.follow, library);
    const plugin::Table<Real>& table = library.table<Real>();
    const plugin::Function<Real>* function = nullptr;
    for (int k = 0; k < table.function_count; ++k)
        if (options.function == table.functions[k].name) function = &table.functions[k];
    if (!function) throw InputError("the plugin has no function " + options.function);
    std::ifstream in(options.input, std::ios::binary | std::ios::ate);
    if (!in) throw InputError(options.input + ": cannot be read");
    const size_t row_bytes = sizeof(Real) * size_t(function->columns_in), bytes = size_t(in.tellg());
    if (bytes % row_bytes != 0)
        throw InputError(options.input + ": holds no whole number of rows of " + std::to_string(function->columns_in) +
                         " columns");
    const int64_t count = int64_t(bytes / row_bytes);
    std::vector<Real> rows(size_t(count) * function->columns_in), results(size_t(count) * function -> columns_out);
    in.seekg(0);
    in.read(reinterpret_cast<char*>(rows.data()), std::streamsize(bytes));
    if (!options.bodies.empty()) {
        const size_t size = results.size();
        results.resize(size * options.bodies.size());
        for (size_t k = 0; k < options.bodies.size(); ++k) {
            library.choose(options.bodies[k]);
            function->evaluate(count, rows.data(), results.data() + k * size);
        }
    } else if (options.trace.empty()) {
        function->evaluate(count, rows.data(), results.data());
    } else {
        Traced traced(library);
        traced.evaluate(*function, count, rows.data(), results.data());
        traced.write(options.trace);
    }
    if (options.repeat && !options.statistics.empty()) {  // what came so far has warmed caches and clock
        std::vector<double> seconds;
        for (int turn = 0; turn < options.repeat; ++turn) {
            const double start = now_ms();
            function->evaluate(count, rows.data(), results.data());
            seconds.push_back((now_ms() - start) / 1000);
        }
        std::ofstream statistics(options.statistics);
        statistics << json::text(toml::table{{"rows", count}, {"seconds", json::array(seconds)}});
        statistics.close();
        if (!statistics) throw InfrastructureError(options.statistics + ": cannot be written");
    }
    if (!options.follow.empty()) write_missing<Real>(options.follow);
    std::ofstream out(options.output, std::ios::binary);
    out.write(reinterpret_cast<const char*>(results.data()), std::streamsize(results.size() * sizeof(Real)));
    out.close();
    if (!out) throw InfrastructureError(options.output + ": cannot be written");
}

}  // namespace

void add_evaluate(CLI::App& app) {
    CLI::App* command = app.add_subcommand("evaluate", "evaluate one function over rows of raw numbers");
    const auto options = std::make_shared<EvaluateOptions>();
    command->add_option("plugin", options->plugin, "plugin")->required();
    command->add_option("function", options->function, "function")->required();
    command->add_option("input", options->input, "rows: float32 (float64 for a double plugin), columns as declared")
        ->required();
    command->add_option("output", options->output, "result rows, the same type")->required();
    command->add_option("--follow", options->follow,
                        "folder of FUNCTION.known: recorded outputs that stand in for those functions when the "
                        "evaluated one calls them; FUNCTION.missing is written there");
    command->add_option("--repeat", options->repeat, "evaluate all rows so many times more, for --statistics")
        ->check(CLI::Range(1, 1000000));
    command->add_option("--statistics", options->statistics, "with --repeat: write each repeat's seconds as JSON");
    command->add_option("--trace", options->trace,
                        "write what the function compares for each row, of a plugin with -DSHADELAB_TRACE");
    command
        ->add_option("--bodies", options->bodies,
                     "numbers of bodies, of a plugin that has several: all rows with the first, then all with the next")
        ->delimiter(',');
    command->callback([options] {
        const PluginLibrary library(options->plugin);
        library.is_double() ? evaluate<double>(*options, library) : evaluate<float>(*options, library);
    });
}

}  // namespace shadelab
