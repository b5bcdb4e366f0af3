// evaluate: one function over rows of raw numbers.

#include "commands.hpp"

#include "text/json.hpp"

#include <shadelab/error.hpp>
#include <shadelab/plugin_library.hpp>

#include <fstream>
#include <map>
#include <memory>

namespace shadelab {

namespace {

struct EvaluateOptions {
    std::string plugin, function, input, output, follow, statistics;
    int repeat = 0;
};

// ---- follow-through

std::vector<char> read_bytes(const std::string& file) {
    std::ifstream in(file, std::ios::binary);
    if (!in) throw InputError(file + ": cannot be read");
    return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

/// Answers the calls of a plugin that is followed (plugin.hpp) from recorded outputs, and collects what is not recorded.
/// Arguments count as equal when they are the same float32 numbers: that is how they were recorded.
template <class Real>
struct Followed {
    struct Record {
        std::map<std::vector<float>, std::vector<Real>> known;
        std::map<std::vector<float>, int64_t> missing;  ///< arguments, and the order in which they came
    };
    static inline std::map<int, Record> records;  ///< by the function's index in the plugin's table
    static inline const plugin::Table<Real>* table;

    static bool answer(int index, const Real* in, Real* out) {
        const auto record = records.find(index);
        if (record == records.end()) return false;
        std::vector<float> key(in, in + table->functions[index].columns_in);
        for (float& value : key) value += 0.0f;  // -0 and 0 are the same argument
        const auto found = record->second.known.find(key);
        if (found == record->second.known.end()) {
            record->second.missing.try_emplace(std::move(key), int64_t(record->second.missing.size()));
            return false;
        }
        std::copy(found->second.begin(), found->second.end(), out);
        return true;
    }
};

/// FOLDER/FUNCTION.known for each function that is to be followed: rows of Real, arguments and then results; may be empty.
template <class Real>
void start_following(const std::string& folder, const PluginLibrary& library) {
    using F = Followed<Real>;
    F::table = &library.table<Real>();
    for (int k = 0; k < F::table->function_count; ++k) {
        const plugin::Function<Real>& function = F::table->functions[k];
        const std::string file = folder + "/" + function.name + ".known";
        if (!std::filesystem::exists(file)) continue;
        auto& record = F::records[k];
        const std::vector<char> bytes = read_bytes(file);
        const size_t width = size_t(function.columns_in + function.columns_out);
        const Real* row = reinterpret_cast<const Real*>(bytes.data());
        for (size_t left = bytes.size() / (width * sizeof(Real)); left > 0; --left, row += width) {
            std::vector<float> key(row, row + function.columns_in);
            for (float& value : key) value += 0.0f;
            record.known.try_emplace(std::move(key), row + function.columns_in, row + width);
        }
    }
    library.follow<Real>(F::answer);
}

/// FOLDER/FUNCTION.missing: the float32 arguments of the calls that no record answered, each once, in the order of the calls.
template <class Real>
void write_missing(const std::string& folder) {
    for (const auto& [index, record] : Followed<Real>::records) {
        const plugin::Function<Real>& function = Followed<Real>::table->functions[index];
        std::vector<float> rows(record.missing.size() * size_t(function.columns_in));
        for (const auto& [arguments, place] : record.missing)
            std::copy(arguments.begin(), arguments.end(), rows.begin() + place * function.columns_in);
        const std::string file = folder + "/" + function.name + ".missing";
        std::ofstream out(file, std::ios::binary);
        out.write(reinterpret_cast<const char*>(rows.data()), std::streamsize(rows.size() * sizeof(float)));
        out.close();
        if (!out) throw InfrastructureError(file + ": cannot be written");
    }
}

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
    function->evaluate(count, rows.data(), results.data());
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
    command->callback([options] {
        const PluginLibrary library(options->plugin);
        library.is_double() ? evaluate<double>(*options, library) : evaluate<float>(*options, library);
    });
}

}  // namespace shadelab
