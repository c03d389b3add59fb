"""From the exact cost-to-go to a robot that assists a team.

In the order in which they build on each other:

choices        what a person can do in each state, as arrays
human          perceived cost, choice, influence, trust; people and populations
belief         belief over (beta, theta)
archive        frozen dataclasses of arrays as files
pomdp          one person's assistance problem
region         the part of a large task that matters to it
mdp            its values where beta and theta are seen; the QMDP policy
vectors        policies made of alpha vectors
search         bounds on the value at every belief, and how they are improved
envelope       the upper bound at a belief, solved to the end
solver         its policy, with proven bounds
exchange       problems and policies in other programs' formats
team           what a team is to its robot, and what a policy for it looks like
attention      team policies: no assistance, reactive, attention switching
visits         one person's problem with a robot that comes and goes, at a price
priority       a team policy of our own
pool           the people from whom teams are drawn
acting         one step of many people, compiled
episodes       what became of simulated episodes
simulate       episodes of a team
bounds         what no team policy exceeds
joint          a tiny team's problem as a whole, solved between bounds
watching       what the robot believed in an episode
log            recorded actions, as a log has them and as the task has them
fit            beta, theta and eta of a person, from recorded actions
misconception  sigma, and what a person takes for the cost-to-go
crowd          the distribution of beta and theta over people
diagnostics    whether the model fits
profile        all that a log says of each person
figures        pictures (extra `plots`)
fit_figures    pictures of what was learned from people (extra `plots`)
study_figures  pictures of a study: policies, team sizes, kinds of people, costs (extra `plots`)
statistics     means, savings and effects with intervals over pools of people
study          a study as data, and what is done in one go
protocol       studies from TOML files
running        a study carried out, in parallel and resumable (extra `study` to load its results)
summary        what a study found, in numbers (extra `study`)
report         the report of a study (extra `study`)
cli            the command `kitassist`, a file for each of its commands
"""
